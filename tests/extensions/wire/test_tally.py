import pytest
from wire_packets import (
    GROUP,
    HOST,
    LIVELINESS_WRITER,
    OUTGOING,
    PING,
    PREFIX,
    RELAY,
    SEDP_WRITER,
    SPDP_WRITER,
    acknack,
    data,
    data_frag,
    fragmented,
    frame_batch,
    heartbeat,
    info_dst,
    info_ts,
    ipv4,
    nack_frag,
    rtps,
    stamped,
    submessage,
    tcp,
    udp,
)

from dds_trace.extensions.wire import tally as tally_module
from dds_trace.extensions.wire.classes import WireClass
from dds_trace.extensions.wire.format import NEVER_NS, Direction
from dds_trace.extensions.wire.packet_filter import PortRange
from dds_trace.extensions.wire.tally import WireTally

RUN = 0xABC
DOMAIN = PortRange(7400, 7649)


@pytest.fixture
def tally():
    return WireTally()


def add(tally, frames, times_ns=None, *, packet_type=OUTGOING, is_loopback=False, captured=None):
    batch = frame_batch(frames, times_ns, captured, packet_type)
    tally.add(batch, "link0", is_loopback=is_loopback, wall_to_monotonic_ns=1000)


def counted(tally):
    return {
        (kind, direction): (one.packets, one.bytes, one.submessages, one.ip_fragments)
        for (kind, direction), one in tally.run.classes.items()
    }


def message(sequence, run_id=RUN, relay_id=0, number=None):
    return data(sequence if number is None else number, stamped(run_id, sequence, relay_id))


def test_a_packet_of_one_class_has_all_its_headers(tally):
    frame = ipv4(udp(rtps(info_ts(), message(1))))
    add(tally, [frame])
    assert counted(tally) == {(WireClass.DATA, Direction.SENT): (1, len(frame), 1, 0)}


def test_of_a_packet_of_two_classes_the_second_has_its_own_bytes_alone(tally):
    frame = ipv4(udp(rtps(info_ts(), message(1), heartbeat(1, 1))))
    add(tally, [frame])
    assert counted(tally) == {
        (WireClass.DATA, Direction.SENT): (1, len(frame) - 32, 1, 0),
        (WireClass.HEARTBEAT, Direction.SENT): (0, 32, 1, 0),
    }


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (heartbeat(1, 1), WireClass.HEARTBEAT),
        (acknack(1), WireClass.ACKNACK),
        (nack_frag(1), WireClass.NACK_FRAG),
        (submessage(0x08, bytes(32)), WireClass.GAP),
        (submessage(0x13, bytes(24)), WireClass.HEARTBEAT_FRAG),
        (data(1, bytes(50), writer=SPDP_WRITER), WireClass.SPDP),
        (data(1, bytes(50), writer=SEDP_WRITER), WireClass.SEDP),
        (acknack(1, writer=SEDP_WRITER), WireClass.SEDP),
        (data(1, bytes(50), writer=LIVELINESS_WRITER), WireClass.LIVELINESS),
        (submessage(0x33, bytes(20)), WireClass.SECURE),
        (submessage(0x80, bytes(20)), WireClass.RTPS_OTHER),
        (info_dst(), WireClass.RTPS_OTHER),
    ],
)
def test_a_packets_class(content, kind, tally):
    add(tally, [ipv4(udp(rtps(content)))])
    assert [found for found, _ in counted(tally)] == [kind]


def test_directions():
    for packet_type, is_loopback, direction in [
        (OUTGOING, False, Direction.SENT),
        (HOST, False, Direction.RECEIVED),
        (HOST, True, Direction.LOCAL),
        (3, False, None),  # for another host
    ]:
        tally = WireTally()
        add(tally, [ipv4(udp(rtps(message(1))))], packet_type=packet_type, is_loopback=is_loopback)
        assert list(counted(tally)) == [(WireClass.DATA, direction)] * (direction is not None)


def test_a_repeated_message(tally):
    frame = ipv4(udp(rtps(message(1, number=77))))
    add(tally, [frame, frame, frame], [50, 250, 900])
    assert counted(tally) == {
        (WireClass.DATA, Direction.SENT): (1, len(frame), 1, 0),
        (WireClass.DATA_AGAIN, Direction.SENT): (2, 2 * len(frame), 2, 0),
    }
    (row,) = tally.take_rows(RUN)
    assert row.tolist() == (RUN, 1, 0, Direction.SENT, 1, 2, 2, 64, 1050, 1900, 200, 0)


def test_a_repetition_to_one_reader_of_what_went_to_a_group(tally):
    packet = udp(rtps(message(1)))
    add(tally, [ipv4(packet, destination=GROUP), ipv4(packet, destination=RELAY)])
    assert [kind for kind, _ in counted(tally)] == [WireClass.DATA, WireClass.DATA_AGAIN]


def test_rows_are_of_the_run_alone_and_in_order(tally):
    packets = [message(2, number=1), message(1, number=2), message(5, run_id=1, number=3), data(4, bytes(64))]
    add(tally, [ipv4(udp(rtps(packet))) for packet in packets])
    rows = tally.take_rows(RUN)
    assert rows["sequence"].tolist() == [1, 2]
    assert rows["resent_after_ns"].tolist() == [NEVER_NS, NEVER_NS]
    assert len(tally.take_rows(RUN)) == 0


def test_a_message_in_ip_fragments_counts_all_of_them_and_all_its_headers(tally):
    parts = [data_frag(1, 1, stamped(RUN, 0, more=bytes(1280)), 8000)]
    parts += [data_frag(1, number, bytes(1344), 8000) for number in range(2, 7)]
    datagram = udp(rtps(info_ts(), *parts, heartbeat(1, 1)))
    frames = fragmented(datagram, 1480)
    add(tally, frames)
    size = sum(map(len, frames))
    assert counted(tally) == {
        (WireClass.DATA_FRAG, Direction.SENT): (len(frames), size - 32, 6, len(frames)),
        (WireClass.HEARTBEAT, Direction.SENT): (0, 32, 1, 0),
    }
    (row,) = tally.take_rows(RUN)
    assert (row["fragments"], row["sample_bytes"]) == (6, 8000)
    assert tally.run.unseen_headers == 0


def test_fragments_find_their_first_in_an_earlier_batch(tally):
    frames = fragmented(udp(rtps(data(1, bytes(4000)))), 1480)
    for frame in frames:
        add(tally, [frame])
    assert counted(tally) == {(WireClass.DATA, Direction.SENT): (3, sum(map(len, frames)), 1, 3)}


def test_a_fragment_without_its_first_is_unknown(tally):
    _, second, _ = fragmented(udp(rtps(data(1, bytes(4000)))), 1480)
    add(tally, [second])
    assert list(counted(tally)) == [(WireClass.FRAGMENT_UNKNOWN, Direction.SENT)]


def test_a_header_that_was_not_captured_is_admitted(tally):
    frame = ipv4(udp(rtps(data(1, bytes(1000)), heartbeat(1, 1))))
    add(tally, [frame], captured=[200])
    assert tally.run.unseen_headers == 1
    assert counted(tally) == {(WireClass.DATA, Direction.SENT): (1, len(frame), 1, 0)}


def test_a_first_fragment_that_was_cut_short_ends_the_trail(tally):
    frames = fragmented(udp(rtps(data(1, bytes(1000)), data(2, bytes(4000)), heartbeat(1, 1))), 1480)
    add(tally, frames, captured=[200, None, None, None])
    assert (tally.run.unseen_headers, tally.unfollowed_datagrams) == (1, 0)
    assert sum(size for _, size, _, _ in counted(tally).values()) == sum(map(len, frames))


def test_padding_of_a_short_frame_is_no_submessage(tally):
    add(tally, [ipv4(udp(rtps(info_ts()))) + bytes(16)])
    assert list(counted(tally)) == [(WireClass.RTPS_OTHER, Direction.SENT)]
    assert tally.run.unseen_headers == 0


def test_requests_and_the_gap_between_heartbeats_without_data(tally):
    packets = [heartbeat(1, 1), heartbeat(1, 2), acknack(1, 2), acknack(3), nack_frag(1), acknack(1, 2, SEDP_WRITER)]
    packets += [message(3) + heartbeat(1, 3), heartbeat(1, 3)]
    add(tally, [ipv4(udp(rtps(packet))) for packet in packets], [0, 100, 101, 102, 103, 104, 200, 400])
    assert tally.run.requests == 2
    assert tally.run.heartbeat_gap_p50_ns == (100 + 300) / 2


def test_when_it_all_began(tally):
    announcement = data(1, bytes(50), writer=SPDP_WRITER)
    packets = [heartbeat(1, 1), announcement, message(0, run_id=0), message(0, run_id=0, relay_id=5, number=8)]
    add(tally, [ipv4(udp(rtps(packet))) for packet in packets + packets])
    assert tally.beginnings == {"first_spdp_ns": 1001, "first_data_ns": 1002, "first_reply_ns": 1003}


def test_another_domains_participants_are_left_out_with_their_fragments():
    tally = WireTally([DOMAIN])
    own, other = PREFIX, b"another one."
    announcement = data(1, bytes(50), writer=SPDP_WRITER)
    frames = [
        ipv4(udp(rtps(announcement, prefix=own), destination_port=7400), destination=GROUP),
        ipv4(udp(rtps(announcement, prefix=other), destination_port=7650), destination=GROUP),
        # Ports from the ephemeral range on both sides: known by the participant alone.
        ipv4(udp(rtps(message(1), prefix=own), 40000, 40001)),
        ipv4(udp(rtps(message(1), prefix=other), 40002, 40003)),
        *fragmented(udp(rtps(data(9, bytes(2000)), prefix=other), 40002, 40003), 1480, ip_id=9),
    ]
    add(tally, frames)
    assert {kind: packets for (kind, _), (packets, *_) in counted(tally).items()} == {
        WireClass.SPDP: 1,
        WireClass.DATA: 1,
    }
    assert tally.run.foreign_packets == 4


def test_tcp_data_again_acknowledgements_and_a_new_connection(tally):
    segments = [tcp(100, bytes(50)), tcp(150, bytes(50)), tcp(175, bytes(50)), tcp(225)]
    segments += [tcp(9, flags=0x02), tcp(10, bytes(50))]
    frames = [ipv4(segment, protocol=6) for segment in segments]
    add(tally, frames, captured=[134] * 6)
    assert counted(tally) == {
        (WireClass.TCP_DATA, Direction.SENT): (3, 348, 0, 0),
        (WireClass.TCP_DATA_AGAIN, Direction.SENT): (1, 116, 0, 0),
        (WireClass.TCP_CONTROL, Direction.SENT): (2, 132, 0, 0),
    }
    assert tally.run.tcp_again_bytes == 25


def test_other_udp_and_its_fragments(tally):
    frames = fragmented(udp(bytes(3000), 7446, 7446), 1480)
    add(tally, frames)
    assert counted(tally) == {(WireClass.UDP_OTHER, Direction.SENT): (3, sum(map(len, frames)), 0, 3)}


def test_a_run_begins_with_empty_counters_and_known_writers(tally):
    frame = ipv4(udp(rtps(message(1))))
    add(tally, [frame])
    tally.begin()
    assert counted(tally) == {}
    add(tally, [frame])
    assert list(counted(tally)) == [(WireClass.DATA_AGAIN, Direction.SENT)]


def test_rows_of_all_runs_leave_readiness_probes_out(tally):
    packets = [message(0, run_id=run_id, number=run_id) for run_id in (0, 1, 2)]
    add(tally, [ipv4(udp(rtps(packet))) for packet in packets])
    assert tally.take_rows()["run_id"].tolist() == [1, 2]


def test_who_speaks_to_a_known_participant_is_of_its_domain():
    tally = WireTally([DOMAIN])
    announcement = data(1, bytes(50), writer=SPDP_WRITER)
    peer, other = b"its peer....", b"another one."
    frames = [
        ipv4(udp(rtps(announcement), 40000, 7400), source=PING, destination=GROUP),
        ipv4(udp(rtps(info_dst(PREFIX), announcement, prefix=peer), 50000, 40000)),
        ipv4(udp(rtps(message(1), prefix=peer), 50000, 50001)),
        ipv4(udp(rtps(info_dst(b"someone else"), message(1), prefix=other), 50000, 40001)),
        ipv4(udp(rtps(message(1), prefix=other), 50000, 40001)),
    ]
    add(tally, frames)
    assert tally.run.foreign_packets == 2


def test_a_submessage_of_several_fragments(tally):
    part = data_frag(1, 2, bytes(3000), 8000, count=3)
    add(tally, [ipv4(udp(rtps(part))), ipv4(udp(rtps(data_frag(1, 3, bytes(1000), 8000))))])
    first, again = (
        tally.run.classes[kind, Direction.SENT] for kind in (WireClass.DATA_FRAG, WireClass.DATA_FRAG_AGAIN)
    )
    assert (first.submessages, first.fragments) == (1, 3)
    assert (again.submessages, again.fragments) == (1, 1)


def test_how_many_heartbeats_a_message_waited_for(tally):
    other_writer = heartbeat(1, 1, writer=0x00002203)
    packets = [heartbeat(1, 0), message(1, number=1) + heartbeat(1, 1), other_writer, heartbeat(1, 1)]
    packets += [message(1, number=1), heartbeat(1, 1), message(1, number=1), message(2, number=2)]
    add(tally, [ipv4(udp(rtps(packet))) for packet in packets])
    assert tally.take_rows(RUN)["waited_heartbeats"].tolist() == [2, 0]


def test_rows_are_packed_when_there_are_many(monkeypatch, tally):
    monkeypatch.setattr(tally_module, "_ROWS_AT_ONCE", 2)
    second_ns = 1_000_000_000
    numbers = [5, 3, 4, 1, 2]
    frames = [ipv4(udp(rtps(message(sequence, number=number)))) for number, sequence in enumerate(numbers)]
    for number, frame in enumerate(frames):  # each batch forgets what is older than half a minute
        add(tally, [frame], [number * 40 * second_ns])
    assert tally.take_rows(RUN)["sequence"].tolist() == [1, 2, 3, 4, 5]
    assert len(tally.take_rows(RUN)) == 0


def test_all_groups_from_224_on_are_one_destination_and_hosts_are_several(tally):
    frames = [
        ipv4(udp(rtps(message(1, number=number))), destination=destination)
        for number, destinations in enumerate((("224.0.0.0", GROUP), ("223.255.255.255", RELAY), (PING, RELAY)))
        for destination in destinations
    ]
    add(tally, frames)
    assert [(kind, packets) for (kind, _), (packets, *_) in counted(tally).items()] == [
        (WireClass.DATA, 5),
        (WireClass.DATA_AGAIN, 1),
    ]
    assert tally.run.packets == 6


def test_the_last_port_of_a_domain_is_its_own():
    tally = WireTally([DOMAIN])
    for number, port in enumerate((7649, 7648, 7650)):
        add(tally, [ipv4(udp(rtps(message(1), prefix=b"participant%d" % number), 40000, port))])
    assert tally.run.foreign_packets == 1


def test_who_is_spoken_to_is_read_from_what_was_captured():
    tally = WireTally([DOMAIN])
    add(tally, [ipv4(udp(rtps(message(1)), 40000, 7400))])
    answer = ipv4(udp(rtps(info_dst(PREFIX), prefix=b"its peer...."), 50000, 40000))
    add(tally, [answer], captured=[len(answer) - 1])
    assert tally.run.foreign_packets == 1
    add(tally, [answer])
    assert tally.run.foreign_packets == 1
    add(tally, [ipv4(udp(rtps(prefix=b"another one."), 50000, 40000))])
    assert tally.run.foreign_packets == 2


def test_repeats_and_trails_that_are_lost_count_for_their_run(tally):
    minute_ns = 60_000_000_000
    old = ipv4(udp(rtps(message(1, number=1))))
    add(tally, [old], [0])
    for minute, late in enumerate((1, 2, 1), 1):  # the second run begins in the third minute
        if minute == 3:
            tally.begin()
        add(tally, [ipv4(udp(rtps(message(9, number=10 * minute))))], [minute * minute_ns])
        cut = fragmented(udp(rtps(data(10 * minute + 1, bytes(2000)), data(10 * minute + 2, bytes(2000)))), 1480)
        add(tally, [old, cut[0], cut[2]], [minute * minute_ns + 1] * 3)
        assert (tally.late_repeats, tally.unfollowed_datagrams) == (late, late)


def test_datagrams_without_our_headers_have_no_trail_to_lose():
    tally = WireTally([DOMAIN])
    other = udp(rtps(data(9, bytes(3000)), prefix=b"another one."), 40002, 40003)
    add(tally, [*fragmented(udp(bytes(3000), 7446, 7446), 1480), *fragmented(other, 1480, ip_id=9)])
    assert (tally.run.foreign_packets, tally.unfollowed_datagrams) == (3, 0)


@pytest.mark.parametrize(("cut", "unseen"), [(0, 0), (1, 1)])
def test_a_header_across_two_fragments_is_seen_if_the_first_was_captured_whole(cut, unseen, tally):
    # The second submessage begins 12 bytes before the first fragment's end.
    datagram = udp(rtps(data(1, bytes(1480 - 28 - 24 - 12)), data(2, bytes(2000))))
    frames = fragmented(datagram, 1480)
    add(tally, frames, captured=[len(frames[0]) - cut, None, None])
    assert tally.run.unseen_headers == unseen
    assert tally.run.classes[WireClass.DATA, Direction.SENT].submessages == 2 - unseen


@pytest.mark.parametrize(("seen", "packets"), [(20, 1), (19, 0)])
def test_a_tcp_header_takes_20_bytes(seen, packets, tally):
    add(tally, [ipv4(tcp(1, bytes(9)), protocol=6)], captured=[34 + seen])
    assert sum(one[0] for one in counted(tally).values()) == packets
