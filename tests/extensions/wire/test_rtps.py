import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_packets import (
    WRITER,
    acknack,
    data,
    data_frag,
    data_with_inline_qos,
    heartbeat,
    info_dst,
    info_ts,
    nack_frag,
    stamped,
    submessage,
)

from dds_trace.extensions.wire import rtps
from dds_trace.extensions.wire.messages import stamp_at
from dds_trace.extensions.wire.rtps import Submessage, walk_submessages
from dds_trace.recorder.payloads.stamp import Stamp


def walk(packet, seen=None):
    seen_end = len(packet) if seen is None else seen
    return walk_submessages(memoryview(packet), 0, seen_end, len(packet))


def test_a_datas_fields():
    found, next_at = walk(data(5, bytes(40)))
    assert found == [Submessage(rtps.DATA, 64, WRITER, 5, 0, 1, 40, payload_at=24)]
    assert next_at == 64
    assert Submessage(7, 32) == (7, 32, 0, 0, 0, 0, 0, False, None)


def test_a_sequence_number_of_more_than_32_bits_in_either_byte_order():
    for order in "<>":
        (found,), _ = walk(data((7 << 32) + 9, b"", order=order))
        assert found.sequence == (7 << 32) + 9


def test_a_data_frags_fields():
    (found,), _ = walk(data_frag(5, 3, bytes(100), 70000, count=2))
    assert found == Submessage(rtps.DATA_FRAG, 136, WRITER, 5, 3, 2, 70000)


def test_a_data_frag_holds_no_more_fragments_than_it_has_room_for():
    absurd = bytearray(data_frag(5, 3, bytes(100), 70000))
    absurd[28:30] = b"\xff\xff"
    (found,), _ = walk(bytes(absurd))
    assert found.fragments == 2  # headers included, as inline QoS may be


def test_only_the_first_fragment_has_the_samples_beginning():
    (found,), _ = walk(data_frag(5, 1, bytes(100), 70000))
    assert found.payload_at == 36


def test_inline_qos_stands_before_the_payload():
    packet = data_with_inline_qos(1, stamped(0xAB, 12, 3))
    (found,), _ = walk(packet)
    assert found.payload_at == 24 + 12 + 4
    assert stamp_at(memoryview(packet), found.payload_at, len(packet)) == Stamp(0xAB, 12, 3)


def test_inline_qos_without_an_end_gives_no_payload():
    head = data_with_inline_qos(1, b"")[4:24]
    (found,), _ = walk(submessage(0x15, head + b"\x71\x00\x08\x00" + bytes(8), 0x07))
    assert (found.payload_at, found.sample_bytes) == (None, 0)


def test_inline_qos_may_hold_what_looks_like_its_end_and_be_all_there_is():
    packet = bytearray(data_with_inline_qos(1, b""))
    packet[28:36] = b"\x01\x00\x00\x00" * 2
    (found,), _ = walk(bytes(packet))
    assert (found.payload_at, found.sample_bytes) == (40, 0)


@pytest.mark.parametrize(("packet", "place"), [(data_frag(9, 3, b"", 10), 16), (heartbeat(9, 9), 12)])
def test_other_sequence_numbers_have_more_than_32_bits_too(packet, place):
    high = packet[:place] + b"\x07\0\0\0" + packet[place + 4 :]
    (found,), _ = walk(high)
    assert found.sequence == (7 << 32) + 9


def test_fragments_of_one_byte():
    (found,), _ = walk(data_frag(5, 3, bytes(40), 70, count=40))
    assert found.fragments == 40


def test_padding_may_end_a_packet():
    found, next_at = walk(heartbeat(1, 1) + submessage(0x01, b""))
    assert ([one.kind for one in found], next_at) == ([rtps.HEARTBEAT, rtps.PAD], 36)


def test_submessages_follow_each_other():
    found, _ = walk(info_dst() + info_ts() + data(1, bytes(8)) + heartbeat(1, 9))
    assert [one.kind for one in found] == [rtps.INFO_DST, rtps.INFO_TS, rtps.DATA, rtps.HEARTBEAT]
    assert found[-1].writer == WRITER


@pytest.mark.parametrize(("missing", "asks"), [(0, False), (1, True), (3, True)])
def test_an_acknack_asks_only_if_something_is_missing_a_nack_frag_always(missing, asks):
    (found,), _ = walk(acknack(4, missing))
    assert (found.sequence, found.asks) == (4, asks)
    (found,), _ = walk(nack_frag(6))
    assert (found.sequence, found.asks, found.writer) == (6, True, WRITER)


def test_length_zero_reaches_to_the_end():
    (found,), next_at = walk(submessage(0x15, data(1, bytes(50))[4:], 5, length=0))
    assert (found.wire_bytes, found.sample_bytes, next_at) == (74, 50, 74)
    (_, later), next_at = walk(info_ts() + submessage(0x15, data(1, bytes(50))[4:], 5, length=0))
    assert (later.wire_bytes, later.sample_bytes, next_at) == (74, 50, 86)


def test_length_zero_of_an_invalidated_time_is_zero():
    found, _ = walk(submessage(0x09, b"", 3) + heartbeat(1, 1))
    assert [one.kind for one in found] == [rtps.INFO_TS, rtps.HEARTBEAT]


def test_the_walk_stops_before_a_header_that_was_not_captured():
    first, second = data(1, bytes(100)), data_frag(2, 1, bytes(100), 200)
    for seen, count in [(len(first) + 36, 2), (len(first) + 35, 1), (len(first) + 3, 1), (24, 1), (23, 0)]:
        found, next_at = walk(first + second, seen)
        assert len(found) == count
        assert next_at == (0, len(first), len(first + second))[count]


@pytest.mark.parametrize(
    ("kind", "least"), [(0x15, 24), (0x16, 36), (0x07, 28), (0x13, 24), (0x08, 20), (0x06, 24), (0x12, 28)]
)
def test_what_is_shorter_than_its_fields_is_unknown(kind, least):
    assert [walk(submessage(kind, bytes(size - 4)))[0][0].kind for size in (least, least - 1)] == [kind, 0]


@pytest.mark.parametrize("broken", [submessage(0x15, b"", 1, length=5000), submessage(0x16, bytes(8))])
def test_what_is_not_rtps_is_one_unknown_submessage(broken):
    packet = info_ts() + broken + bytes(20)
    found, next_at = walk(packet)
    assert [(one.kind, one.wire_bytes) for one in found] == [(rtps.INFO_TS, 12), (0, len(packet) - 12)]
    assert next_at == len(packet)


@given(st.binary(max_size=300), st.integers(0, 300))
def test_any_octets_are_walked_without_an_error_and_never_past_their_end(packet, seen):
    found, next_at = walk(packet, min(seen, len(packet)))
    assert 0 <= next_at <= len(packet)
    assert sum(one.wire_bytes for one in found) == next_at


@pytest.mark.parametrize("place", [8, 16])
def test_the_stamp_stands_at_one_of_two_places(place):
    text = bytes(place) + b"dt1:00000000000000ff:0000000000000010:00000002"
    assert stamp_at(memoryview(text), 0, len(text)) == Stamp(255, 16, 2)
    assert stamp_at(memoryview(text), 0, len(text) - 1) is None


def test_other_messages_have_no_stamp():
    assert stamp_at(memoryview(bytes(100)), 0, 100) is None
    assert stamp_at(memoryview(bytes(16) + b"dt1:" + b"z" * 42), 0, 62) is None
