"""The kernel itself runs the filter: over datagrams of a local socket pair, which need no root."""

import socket

import pytest
from wire_packets import (
    GROUP,
    PREFIX,
    RELAY,
    data,
    data_frag,
    fragmented,
    frame_batch,
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

from dds_trace.extensions.wire import rtps as packets_rtps
from dds_trace.extensions.wire.frames import UDP, read_frames
from dds_trace.extensions.wire.packet_filter import (
    LAST_HEADER_BYTES,
    SHORT_BYTES,
    PortRange,
    attach_filter,
    wire_program,
)
from dds_trace.extensions.wire.rtps import DATA_FRAG, HEARTBEAT, FragmentTable, Piece, walk_submessages

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
        ipv4(tcp(1, b"x"), protocol=6, offset=1480),
        ipv4(bytes(8), protocol=1),
        bytes(12) + b"\x08\x06" + bytes(28),
        bytes(12) + b"\x86\xdd" + bytes(60),
        bytes(5),
    ],
    ids=["udp", "short udp", "tcp", "later tcp", "icmp", "arp", "ipv6", "no frame"],
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


BEFORE = 3000
"""Bytes of other packets before each fragment."""


def pieces(datagram, size):
    for offset in range(size, len(datagram), size):
        text = bytes(BEFORE) + datagram[offset : offset + size]
        yield Piece(offset, memoryview(text), BEFORE, len(text), len(text), is_last=offset + size >= len(datagram))


def begin(table, datagram, size, key="d"):
    first = memoryview(datagram[:size])
    walk = walk_submessages(first, 28, len(first), len(datagram))
    table.begin(key, "owner", len(datagram), walk.next_at, bytes(first[walk.next_at :]))
    return list(walk.submessages)


def several(payload_bytes):
    parts = [data_frag(1, number, bytes(payload_bytes), 9000) for number in range(1, 7)]
    return udp(rtps(info_ts(), *parts, heartbeat(1, 1)))


@pytest.mark.parametrize("size", [80, 88, 96, 104, 240, 1480])
@pytest.mark.parametrize("payload_bytes", [4, 60, 200, 1344])
def test_every_header_is_found_wherever_the_datagram_is_cut(size, payload_bytes):
    datagram = several(payload_bytes)
    expected = walk_submessages(memoryview(datagram), 28, len(datagram), len(datagram)).submessages
    table = FragmentTable()
    found = begin(table, datagram, size)
    for piece in pieces(datagram, size):
        owner, more = table.continue_with("d", piece)
        assert owner == "owner"
        found += more
    assert [one[:-1] for one in found] == [one[:-1] for one in expected]
    assert [one.kind for one in found[1:]] == [DATA_FRAG] * 6 + [HEARTBEAT]
    assert table.lost_trails == 0


@pytest.mark.parametrize("size", range(80, 2100, 8))
def test_a_submessage_up_to_the_end_is_found_wherever_it_begins(size):
    datagram = udp(rtps(data(1, bytes(1900)), heartbeat(1, 1), submessage(0x15, data(2, bytes(90))[4:], 5, length=0)))
    expected = walk_submessages(memoryview(datagram), 28, len(datagram), len(datagram)).submessages
    table = FragmentTable()
    found = begin(table, datagram, size) + [
        one for piece in pieces(datagram, size) for one in table.continue_with("d", piece)[1]
    ]
    assert [one[:3] for one in found] == [one[:3] for one in expected]


def test_a_missing_fragment_loses_the_trail_once_and_keeps_the_owner():
    table = FragmentTable()
    datagram = several(1344)
    begin(table, datagram, 1480)
    first, second, *_, last = pieces(datagram, 1480)
    del first
    assert table.continue_with("d", second) == ("owner", [])
    assert table.continue_with("d", last) == ("owner", [])
    assert table.lost_trails == 1
    assert table.continue_with("d", last) is None, "it ended with its last fragment"


def test_a_missing_fragment_within_a_payload_loses_nothing():
    table = FragmentTable()
    datagram = udp(rtps(data(1, bytes(5000)), heartbeat(1, 1), prefix=PREFIX))
    begin(table, datagram, 1480)
    *_, last = pieces(datagram, 1480)
    assert [one.kind for one in table.continue_with("d", last)[1]] == [HEARTBEAT]
    assert table.lost_trails == 0


def test_of_too_many_unfinished_datagrams_the_oldest_goes(monkeypatch):
    monkeypatch.setattr(packets_rtps, "REMEMBERED_DATAGRAMS", 2)
    table = FragmentTable()
    datagram = several(1344)
    for key in "abc":
        begin(table, datagram, 1480, key)
    piece = next(pieces(datagram, 1480))
    assert table.continue_with("a", piece) is None
    assert table.continue_with("b", piece) is not None


RTPS = ipv4(udp(rtps(data(1, bytes(30))), 50_001, 7412), ip_id=513, destination=GROUP)
WITH_OPTIONS = RTPS[:14] + b"\x46\x00" + (len(RTPS) - 14 + 4).to_bytes(2, "big") + RTPS[18:34] + bytes(4) + RTPS[34:]
FRAMES = {
    "rtps": RTPS,
    "options": WITH_OPTIONS,
    "padded": ipv4(udp(bytes(2), 300, 65_000)) + b"RTPS" * 8,
    "almost rtps": ipv4(udp(b"RTPT" + bytes(40))),
    "tcp": ipv4(tcp(9, b"RTPS" * 8), destination="10.0.0.254", protocol=6),
    "first fragment": fragmented(udp(rtps(data(1, bytes(90)))), 64, ip_id=65_000)[0],
    "later fragment": fragmented(udp(rtps() * 9), 64, ip_id=65_000)[1],
    "ipv6": RTPS[:12] + b"\x86\xdd" + RTPS[14:],
    "vlan": RTPS[:12] + b"\x81\x00\x00\x07" + RTPS[12:],
}


def plain(kept, at):
    """The fields of a frame of which `kept` was captured, at `at` in the memory."""

    def number(position, octets):
        return int.from_bytes(kept[position : position + octets], "big")

    if len(kept) < 34 or number(12, 2) != 0x0800:
        names = ("protocol", "fragment_offset", "more_fragments", "source_port", "destination_port")
        return dict.fromkeys((*names, "datagram_bytes", "is_rtps"), 0)
    protocol, flags, end = kept[23], number(20, 2), 14 + number(16, 2)
    transport, seen_end = 14 + 4 * (kept[14] & 15), min(len(kept), end)
    has_ports = flags & 0x1FFF == 0 and transport + 8 <= seen_end
    is_udp = has_ports and protocol == UDP
    return {
        "protocol": protocol,
        "source": number(26, 4),
        "destination": number(30, 4),
        "ip_id": number(18, 2),
        "fragment_offset": 8 * (flags & 0x1FFF),
        "more_fragments": bool(flags & 0x2000),
        "transport": at + transport,
        "transport_end": at + end,
        "seen_end": at + seen_end,
        "source_port": has_ports * number(transport, 2),
        "destination_port": has_ports * number(transport + 2, 2),
        "datagram_bytes": is_udp * number(transport + 4, 2),
        "is_rtps": is_udp and transport + 28 <= seen_end and kept[transport + 8 : transport + 12] == b"RTPS",
    }


@pytest.mark.parametrize("name", FRAMES)
def test_every_cut_of_a_frame_is_read_as_it_stands(name):
    cuts = [FRAMES[name][:seen] for seen in range(1, len(FRAMES[name]) + 1)]
    batch = frame_batch([part for cut in cuts for part in (cut, RTPS)])
    places, found = batch.position.tolist(), list(read_frames(batch, 1000))
    assert [frame.time_ns for frame in found] == [1000 + number for number in range(2 * len(cuts))]
    for number, cut in enumerate(cuts):
        expected = plain(cut, places[2 * number])
        frame = found[2 * number]._asdict()
        assert {key: frame[key] for key in expected} == expected, len(cut)
        assert frame["wire_bytes"] == len(cut)


@pytest.mark.parametrize("seen", [1, 33, 34])
def test_the_last_frame_ends_with_the_memory(seen):
    last = ipv4(udp(b""), destination=RELAY)[:seen]
    batch = frame_batch([RTPS, last])
    frame = list(read_frames(batch, 0))[-1]._asdict()
    expected = plain(last, len(RTPS))
    assert {key: frame[key] for key in expected} == expected
