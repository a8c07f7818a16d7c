"""The kernel itself runs the filter: over datagrams of a local socket pair, which need no root."""

import socket

import pytest
from wire_packets import (
    data,
    data_frag,
    fragmented,
    heartbeat,
    info_dst,
    info_ts,
    ipv4,
    rtps,
    stamped,
    submessage,
    tcp,
    udp,
)

from dds_trace.recorder.wire.packets.packet_filter import (
    LAST_HEADER_BYTES,
    SHORT_BYTES,
    PortRange,
    attach_filter,
    wire_program,
)

HEADERS = 14 + 20 + 8 + 20


@pytest.fixture
def kept():
    """How many bytes of a frame the filter keeps, 0 if it is dropped."""
    sender, receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    attach_filter(receiver, wire_program([PortRange(7446, 7446)], [PortRange(7500, 7510), PortRange(80, 80)]))

    def run(frame):
        try:
            sender.send(frame)
            return len(receiver.recv(1 << 17, socket.MSG_DONTWAIT))
        except (BlockingIOError, PermissionError):  # a local socket tells its sender of a dropped datagram
            return 0

    yield run
    sender.close()
    receiver.close()


@pytest.mark.parametrize(
    "frame",
    [
        ipv4(udp(b"not RTPS, and a port that nobody asked for")),
        ipv4(udp(b"RT")),
        ipv4(tcp(1, b"x", source_port=7511), protocol=6),
        ipv4(bytes(8), protocol=1),
        bytes(12) + b"\x08\x06" + bytes(28),
        bytes(12) + b"\x86\xdd" + bytes(60),
        bytes(5),
    ],
    ids=["udp", "short udp", "tcp", "icmp", "arp", "ipv6", "no frame"],
)
def test_traffic_of_others_is_dropped(kept, frame):
    assert kept(frame) == 0


def test_tcp_of_either_port_is_kept_without_its_payload(kept):
    assert kept(ipv4(tcp(1, bytes(1000), source_port=7510), protocol=6)) == 134
    assert kept(ipv4(tcp(1, bytes(1000), source_port=9, destination_port=80), protocol=6)) == 134


def test_udp_of_an_asked_port_is_kept_without_its_payload(kept):
    assert kept(ipv4(udp(bytes(1000), destination_port=7446))) == 14 + 60 + 8


def test_of_a_long_payload_at_the_end_nothing_but_its_beginning_is_kept(kept):
    packet = rtps(info_ts(), data_frag(1, 2, bytes(60000), 120000))
    assert kept(ipv4(udp(packet))) == max(SHORT_BYTES, HEADERS + 12 + LAST_HEADER_BYTES)


def test_a_header_behind_a_long_payload_is_kept(kept):
    frame = ipv4(udp(rtps(info_ts(), data(1, bytes(30000)), heartbeat(1, 1))))
    assert kept(frame) == len(frame)  # the heartbeat is its last 32 bytes


def test_what_follows_the_last_header_is_left_out(kept):
    before = [info_dst(), data(1, bytes(1000)), heartbeat(1, 1)]
    last_header = HEADERS + sum(map(len, before))
    frame = ipv4(udp(rtps(*before, data(2, bytes(5000)))))
    assert kept(frame) == last_header + LAST_HEADER_BYTES


def test_big_endian_lengths_are_followed(kept):
    before = data(1, bytes(1000), order=">")
    frame = ipv4(udp(rtps(before, data(2, bytes(5000), order=">"))))
    assert kept(frame) == HEADERS + len(before) + LAST_HEADER_BYTES


def test_length_zero_is_the_rest_of_the_packet_except_for_a_time_that_is_taken_back(kept):
    rest = submessage(0x15, bytes(4000), length=0)
    assert kept(ipv4(udp(rtps(rest)))) == SHORT_BYTES
    invalid_time = submessage(0x09, b"", flags=3)
    before = [invalid_time, data(1, bytes(1000))]
    frame = ipv4(udp(rtps(*before, data(2, bytes(5000)))))
    assert kept(frame) == HEADERS + sum(map(len, before)) + LAST_HEADER_BYTES


def test_a_packet_of_more_submessages_than_are_followed_is_kept_whole(kept):
    frame = ipv4(udp(rtps(*[info_dst()] * 40, data(1, bytes(5000)))))
    assert kept(frame) == len(frame)


def test_later_fragments_are_kept_whole_as_headers_may_begin_in_them(kept):
    first, *later = fragmented(udp(rtps(info_ts(), data(1, stamped(1, 1, more=bytes(4000))))), 1480)
    assert kept(first) == SHORT_BYTES
    assert [kept(frame) for frame in later] == [len(frame) for frame in later]


def test_an_ip_header_with_options_is_stepped_over(kept):
    plain = ipv4(udp(rtps(data(1, bytes(2000)), data(2, bytes(2000)))))
    options = bytes(8)
    frame = plain[:14] + bytes([0x47]) + plain[15:34] + options + plain[34:]
    assert kept(frame) == kept(plain) + len(options)
