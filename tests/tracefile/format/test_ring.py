import json
import os
import random
import struct

import numpy as np
import pytest
from trace_files import ping_session

from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.format import ring
from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns, Stage
from dds_trace.tracefile.format.ring import Ring, events_by_stage, read_ring, salvage_ring

SLOTS = 4
SLOTS_AT = 4096


def slot(ticket, stage, sequence=None):
    sequence = ticket if sequence is None else sequence
    return struct.pack("<QQqqqqII", 9, sequence, 1000 + ticket, 0, 0, 0, 33, 0) + struct.pack(
        "<Q", ticket + (stage << 56)
    )


def ring_file(path, *slots, dropped=0, slot_count=SLOTS):
    text = json.dumps({"format": 1, "session": json.loads(ping_session(state="open").to_json())}).encode()
    header = struct.pack("<8sIIQQQQ", b"DDSRING\n", 1, 64, slot_count, SLOTS_AT, dropped, len(text)) + text
    path.write_bytes(header.ljust(SLOTS_AT, b"\0") + b"".join(slots).ljust(SLOTS * 64, b"\0"))
    return path


def tickets(path, events_in_trace):
    contents = read_ring(path, events_in_trace)
    assert contents is not None
    return (contents.slots["mark"] & ((1 << 56) - 1)).tolist()


def test_a_ring_as_we_write_it_has_the_documented_bytes(tmp_path):
    ring = Ring(tmp_path / "a.mcap.ring", SLOTS, ping_session(state="open"))
    ring.memory[ring.slots_at : ring.slots_at + 64] = slot(0, 1)
    ring.note_dropped(7)
    data = (tmp_path / "a.mcap.ring").read_bytes()
    assert data[:8] == b"DDSRING\n"
    assert struct.unpack_from("<II", data, 8) == (1, 64)
    slot_count, slots_at, dropped, text_bytes = struct.unpack_from("<QQQQ", data, 16)
    assert (slot_count, slots_at % 4096, dropped) == (SLOTS, 0, 7)
    described = json.loads(data[48 : 48 + text_bytes])
    assert described["session"] == json.loads(ping_session(state="open").to_json())
    assert described["topics"] == {**{str(n): f"/dds_trace/t{n}" for n in (1, 2, 3, 4)}, "5": "/dds_trace/tap"}
    assert data[slots_at : slots_at + 64] == slot(0, 1)
    assert len(data) == slots_at + SLOTS * 64
    assert len(ring.slots) == SLOTS
    assert bytes(ring.words) == data[slots_at:]  # eight words a slot, and nothing beside the slots
    ring.close(delete=True)
    assert list(tmp_path.iterdir()) == []


def test_events_come_by_ticket_and_by_stage(tmp_path):
    path = ring_file(tmp_path / "r", slot(0, 3, sequence=10), slot(1, 4, sequence=10), slot(2, 3, sequence=11))
    contents = read_ring(path, 0)
    assert contents is not None
    assert contents.session == ping_session(state="open")
    by_stage = dict(events_by_stage(contents.slots))
    assert by_stage[Stage.T3]["sequence"].tolist() == [10, 11]
    assert by_stage[Stage.T4]["monotonic_ns"].tolist() == [1001]
    assert Stage.T1 not in by_stage
    assert (contents.missing_events, contents.dropped_events, contents.recording) == (0, 0, False)


def test_what_the_trace_has_is_not_given_again(tmp_path):
    path = ring_file(tmp_path / "r", slot(4, 1), slot(5, 1), slot(2, 1), slot(3, 1), dropped=3)
    assert tickets(path, 2) == [2, 3, 4, 5]
    assert tickets(path, 4) == [4, 5]
    assert tickets(path, 6) == []
    contents = read_ring(path, 4)
    assert contents is not None
    assert contents.dropped_events == 3


def test_tickets_in_neither_file_are_missing(tmp_path):
    path = ring_file(tmp_path / "r", slot(8, 1), slot(5, 1), slot(6, 1), slot(7, 1))
    contents = read_ring(path, 3)  # a power failure took tickets 3 and 4 from the trace
    assert contents is not None
    assert contents.missing_events == 2


@pytest.mark.parametrize(
    "slots",
    [
        # The packer zeroes a slot, then fills it from its first byte to its last.
        *(pytest.param([slot(1, 1)[:packed].ljust(64, b"\0")], id=f"cut at byte {packed}") for packed in range(64)),
        pytest.param([slot(2, 1)], id="mark of another slot"),
        pytest.param([slot(1, 6), slot(2, 0)], id="stages that do not exist"),
        *(pytest.param([slot(1 + (1 << bit), 1)], id=f"ticket 2^{bit}") for bit in range(40, 56)),
    ],
)
def test_what_is_no_event(tmp_path, slots):
    assert tickets(ring_file(tmp_path / "r", slot(0, 1), *slots), 0) == [0]


def test_a_slot_that_is_being_zeroed_still_has_its_old_ticket(tmp_path):
    path = ring_file(tmp_path / "r", bytes(56) + slot(0, 1)[56:], slot(1, 1), slot(2, 1), slot(3, 1))
    assert tickets(path, 1) == [1, 2, 3]  # ticket 4 was about to be packed, so ticket 0 is in the trace


def test_a_slot_without_a_run_is_no_event(tmp_path):
    """Zeroing begins with the run; half of it, caught by a power loss, leaves the old mark behind an event of zeros."""
    path = ring_file(tmp_path / "r", slot(0, 1), bytes(32) + slot(1, 1)[32:], slot(2, 1))
    assert tickets(path, 0) == [0, 2]


@pytest.mark.parametrize("seed", range(20))
def test_garbage_of_a_disk_is_no_event(tmp_path, seed):
    """A sector of noise in place of eight slots: the slots around it count, it does not."""
    slots = [slot(ticket, 1) for ticket in range(24)]
    noise = random.Random(seed).randbytes(512)
    path = ring_file(tmp_path / "r", *slots[:8], noise, *slots[16:], slot_count=24)
    assert tickets(path, 0) == [*range(8), *range(16, 24)]


def test_a_ring_larger_than_any_is_not_read(tmp_path):
    path = ring_file(tmp_path / "r", slot(0, 1), slot_count=1 << 33)
    os.truncate(path, SLOTS_AT + (1 << 33) * 64)  # a file of holes: no block of it is on the disk
    with pytest.raises(TraceFormatError, match="more than any ring"):
        read_ring(path, 0)
    assert salvage_ring(path, 0, ping_session()) is None


@pytest.mark.parametrize("size", [0, 7, 47])
def test_a_ring_killed_before_its_header_holds_nothing(tmp_path, size):
    (tmp_path / "r").write_bytes(bytes(size))
    assert read_ring(tmp_path / "r", 0) is None


def test_a_ring_killed_before_its_magic_holds_nothing(tmp_path):
    path = ring_file(tmp_path / "r", slot(0, 1))
    path.write_bytes(bytes(8) + path.read_bytes()[8:])
    assert read_ring(path, 0) is None


@pytest.mark.parametrize(
    ("offset", "value", "says"),
    [
        (0, b"NOTARING", "not a ring file"),
        (8, struct.pack("<I", 2), "version 2"),
        (16, struct.pack("<Q", 1 << 40), "shorter than its header says"),
        (40, struct.pack("<Q", 1 << 40), "shorter than its header says"),
        (48, b"[", "names no session"),
    ],
)
def test_a_damaged_header_is_a_clear_error(tmp_path, offset, value, says):
    path = ring_file(tmp_path / "r", slot(0, 1))
    data = bytearray(path.read_bytes())
    data[offset : offset + len(value)] = value
    path.write_bytes(data)
    with pytest.raises(TraceFormatError, match=says) as error:
        read_ring(path, 0)
    assert str(path) in str(error.value)


def test_a_living_recorder_shows(tmp_path):
    ring = Ring(tmp_path / "r", SLOTS, ping_session(state="open"))
    contents = read_ring(tmp_path / "r", 0)
    assert contents is not None
    assert contents.recording
    ring.close(delete=False)
    contents = read_ring(tmp_path / "r", 0)
    assert contents is not None
    assert not contents.recording


def test_pending_slots_never_cross_the_end_of_the_ring(tmp_path):
    ring = Ring(tmp_path / "r", SLOTS, ping_session(state="open"))
    assert len(ring.pending(0, 3)) == 3
    assert len(ring.pending(3, 6)) == 1
    assert len(ring.pending(4, 6)) == 2
    ring.close(delete=True)


@pytest.mark.parametrize("whole", [0, 1, 3, SLOTS])
@pytest.mark.parametrize("more", [0, 1, 63])
def test_of_a_ring_that_was_cut_off_every_whole_slot_is_salvaged(tmp_path, whole, more):
    path = ring_file(tmp_path / "r", *(slot(ticket, 1) for ticket in range(SLOTS)))
    path.write_bytes(path.read_bytes()[: SLOTS_AT + 64 * whole + more])
    salvaged = salvage_ring(path, 0, None)
    assert salvaged is not None
    assert (salvaged.slots["mark"] & ((1 << 56) - 1)).tolist() == list(range(whole))


@pytest.mark.parametrize("slots_at", [0, 1 << 40])
def test_slots_at_no_place_of_the_file_are_not_salvaged(tmp_path, slots_at):
    path = ring_file(tmp_path / "r", slot(0, 1))
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 24, slots_at)
    path.write_bytes(data)
    assert salvage_ring(path, 0, ping_session(state="open")) is None


def test_words_of_a_slot_are_where_it_is_packed_and_parts_of_events_join_in_order():
    words = np.frombuffer(ring.SLOT_STRUCT.pack(1, 2, 30, 4, 50, 60, 7, 8, 90), np.int64)
    assert words[[ring.TIME_WORD, ring.SOURCE_WORD, ring.RECEIVED_WORD, ring.MARK_WORD]].tolist() == [30, 50, 60, 90]
    records = np.zeros(3, EVENT_DTYPE)
    records["sequence"] = 1, 2, 3
    whole = EventColumns.from_records(records)
    assert EventColumns.concatenate([whole, whole]).sequence.tolist() == [1, 2, 3, 1, 2, 3]
