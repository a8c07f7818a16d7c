from __future__ import annotations

import pytest
from wire_packets import PREFIX, data, data_frag, heartbeat, info_ts, rtps, submessage, udp

from dds_trace.recorder.wire.packets import rtps as packets_rtps
from dds_trace.recorder.wire.packets.rtps import DATA_FRAG, HEARTBEAT, FragmentTable, Piece, walk_submessages

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


def test_a_fragment_whose_first_was_not_seen_has_no_owner():
    (piece, *_) = pieces(several(1344), 1480)
    assert FragmentTable().continue_with("d", piece) is None


def test_a_missing_fragment_loses_the_trail_once_and_keeps_the_owner():
    table = FragmentTable()
    datagram = several(1344)
    begin(table, datagram, 1480)
    first, second, *_, last = pieces(datagram, 1480)
    del first
    assert table.continue_with("d", second) == ("owner", [])
    assert table.continue_with("d", last) == ("owner", [])
    assert table.lost_trails == 1


def test_a_missing_fragment_within_a_payload_loses_nothing():
    table = FragmentTable()
    datagram = udp(rtps(data(1, bytes(5000)), heartbeat(1, 1), prefix=PREFIX))
    begin(table, datagram, 1480)
    *_, last = pieces(datagram, 1480)
    assert [one.kind for one in table.continue_with("d", last)[1]] == [HEARTBEAT]
    assert table.lost_trails == 0


def test_a_datagram_ends_with_its_last_fragment():
    table = FragmentTable()
    datagram = several(1344)
    begin(table, datagram, 1480)
    *_, last = pieces(datagram, 1480)
    table.continue_with("d", last)
    assert table.continue_with("d", last) is None


def test_of_too_many_unfinished_datagrams_the_oldest_goes(monkeypatch):
    monkeypatch.setattr(packets_rtps, "REMEMBERED_DATAGRAMS", 2)
    table = FragmentTable()
    datagram = several(1344)
    for key in "abc":
        begin(table, datagram, 1480, key)
    piece = next(pieces(datagram, 1480))
    assert table.continue_with("a", piece) is None
    assert table.continue_with("b", piece) is not None
