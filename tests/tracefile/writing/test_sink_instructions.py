"""A sink is killed at every instruction, and each of its writes fails in every way: no event that was kept is lost."""

import errno
import json
import os
import subprocess
import sys

import instruction_kills
import pytest
from instruction_kills import BEFORE, STAMPED_NS
from trace_files import ping_session, run

from dds_trace.base.errors import TraceError
from dds_trace.extensions.bags.recover_trace import recover
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.format.ring import SLOT_WORDS, ring_path
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink


def kill(folder, method, stride):
    """Kill at each instruction of `method`; the numbers of the instructions, and that of a child that got through."""
    command = [sys.executable, instruction_kills.__file__, folder, method, stride]
    told = json.loads(subprocess.run([str(part) for part in command], check=True, capture_output=True).stdout)
    assert [killed for _, killed in told] == [True] * (len(told) - 1) + [False]
    return [number for number, _ in told]


def kept_after_kills(folder, method, stride):
    """Kill at each instruction of `method`: sequences and times that trace and ring hold then, and the last child's."""
    kept = []
    for number in kill(folder, method, stride):
        events = read_trace(folder / f"{number}" / "a.mcap").events[Stage.T1]
        kept.append(list(zip(events.sequence.tolist(), events.monotonic_ns.tolist(), strict=True)))
    return kept


EARLIER = [(sequence, 1000 + sequence) for sequence in range(BEFORE)]
WITH_THE_NEW_ONE = [*EARLIER, (BEFORE, STAMPED_NS)]


@pytest.mark.keeps(1)
@pytest.mark.parametrize("method", ["record", "stamp"])
def test_killed_at_every_instruction_of_an_event(tmp_path, method):
    kept = kept_after_kills(tmp_path, method, 1)
    is_kept = [events == WITH_THE_NEW_ONE for events in kept]
    assert all(events in (EARLIER, WITH_THE_NEW_ONE) for events in kept)
    assert len(kept) > 30
    assert is_kept == sorted(is_kept)  # once it is whole it stays
    assert is_kept[-1]


@pytest.mark.keeps(1)
@pytest.mark.parametrize("method", ["record_and_stamp", "record_expected"])
def test_killed_at_every_instruction_of_an_arrival_and_its_departure(tmp_path, method):
    kept = kept_after_kills(tmp_path, method, 1)
    arrived = [*EARLIER, (BEFORE, 6_000)]
    states = [EARLIER, arrived, [*arrived, (BEFORE, STAMPED_NS)]]
    numbers = [states.index(events) for events in kept]
    assert numbers == sorted(numbers)  # once one of them is whole it stays
    assert set(numbers) == {0, 1, 2}


PAIR = (3, 4)


def open_pairs(folder, slots=64):
    destination = TraceDestination(folder / "pairs.mcap", ring_slots=slots, chunk_seconds=3600.0)
    return TraceSink(destination, ping_session(state="open"), clock_ns=lambda: 42)


def pairs_of(sink):
    closed = sink.close()
    assert closed.dropped_events == 0
    stages = read_trace(closed.path).events
    return [
        list(
            zip(
                stages[stage].sequence.tolist(),
                stages[stage].monotonic_ns.tolist(),
                stages[stage].source_ns.tolist(),
                strict=True,
            )
        )
        for stage in (Stage.T3, Stage.T4)
    ]


@pytest.mark.parametrize("slots", [5, 6, 64])
def test_an_expected_pair_is_the_one_that_would_have_been_kept(tmp_path, slots):
    sink = open_pairs(tmp_path, slots)
    for sequence in range(9):
        expected = sink.expect(PAIR, 1, sequence, 9, 2)
        if expected is None or not sink.record_expected(expected, 40, 7, 8):
            sink.record_and_stamp(PAIR, 1, sequence, 40, 7, 8, 9, 2)
        sink.write_run(run(state="started"))  # drains the ring
    assert pairs_of(sink) == [
        [(sequence, 40, 7) for sequence in range(9)],
        [(sequence, 42, 0) for sequence in range(9)],
    ]


def test_an_expected_pair_that_does_not_come_is_no_event(tmp_path):
    sink = open_pairs(tmp_path)
    assert sink.expect(PAIR, 1, 0, 9, 2) is not None
    assert pairs_of(sink) == [[], []]


def another_event(sink):
    sink.record(3, 1, 5, 41)


def another_expected(sink):
    sink.expect(PAIR, 1, 5, 9, 2)


def an_event_that_is_dropped(sink):
    sink.record(3, 1, 5, "no time")


def another_file(sink):
    destination = TraceDestination(sink._files.writer.path.with_name("next.mcap"), ring_slots=64)
    assert sink.go_on_in(destination) is not None


@pytest.mark.parametrize("meanwhile", [another_event, another_expected, an_event_that_is_dropped, another_file])
def test_what_takes_the_place_of_an_expected_pair_stays_whole(tmp_path, meanwhile):
    sink = open_pairs(tmp_path)
    expected = sink.expect(PAIR, 1, 0, 9, 2)
    meanwhile(sink)
    assert not sink.record_expected(expected, 40, 0, 0)
    before = sink._head
    sink.record_and_stamp(PAIR, 1, 6, 43, 0, 0, 9, 2)
    assert sink._head == before + 2
    sink.close()


@pytest.mark.parametrize("times", [(1 << 63, 0, 0), (1, 1 << 63, 0), (1, 0, "late")])
def test_an_expected_pair_of_times_out_of_range_is_not_kept(tmp_path, times):
    sink = open_pairs(tmp_path)
    expected = sink.expect(PAIR, 1, 0, 9, 2)
    assert not sink.record_expected(expected, *times)
    assert pairs_of(sink) == [[], []]


def test_a_closed_sink_expects_nothing(tmp_path):
    sink = open_pairs(tmp_path)
    expected = sink.expect(PAIR, 1, 0, 9, 2)
    sink.close()
    assert not sink.record_expected(expected, 40, 0, 0)
    assert sink.expect(PAIR, 1, 0, 9, 2) is None
    assert sink.dropped_events == 0


@pytest.mark.parametrize("slots", [5, 6, 64])
def test_an_arrival_and_its_departure_are_two_events_wherever_the_ring_ends(tmp_path, slots):
    sink = open_pairs(tmp_path, slots)
    for sequence in range(9):
        assert sink.record_and_stamp(PAIR, 1, sequence, 40, 7, 8, 9, 2) == 42
        sink.write_run(run(state="started"))  # drains the ring
    closed = sink.close()
    assert closed.dropped_events == 0
    stages = read_trace(closed.path).events
    assert [fields_of(stages[stage]) for stage in (Stage.T3, Stage.T4)] == [
        [(sequence, 40, 0, 7, 8, 9) for sequence in range(9)],
        [(sequence, 42, 0, 0, 0, 9) for sequence in range(9)],
    ]


def fields_of(events):
    """Sequence, time, scheduled, source and received time, and bytes of each event."""
    names = ("sequence", "monotonic_ns", "scheduled_ns", "source_ns", "received_ns", "payload_bytes")
    return list(zip(*(getattr(events, name).tolist() for name in names), strict=True))


@pytest.fixture
def apart(monkeypatch):
    """The heads at which an arrival was recorded apart from its departure."""
    heads, record = [], TraceSink.record

    def note(sink, *event):
        if event[0] == PAIR[0]:
            heads.append(sink._head)
        record(sink, *event)

    monkeypatch.setattr(TraceSink, "record", note)
    return heads


@pytest.mark.parametrize(("before", "expected"), [(0, [4]), (1, [3])])
def test_a_pair_is_one_step_up_to_the_quarter_that_wakes_the_draining_thread(tmp_path, apart, before, expected):
    sink = open_pairs(tmp_path, 16)
    with sink._write_lock:  # the draining thread stands still
        for sequence in range(before):
            sink.record(1, 1, sequence, 41)
        for sequence in range(5):
            sink.record_and_stamp(PAIR, 1, sequence, 40, 7, 8, 9, 2)
    assert apart == expected
    assert pairs_of(sink)[1] == [(sequence, 42, 0) for sequence in range(5)]


@pytest.mark.parametrize(("before", "expected"), [(0, []), (1, [15])])
def test_a_pair_is_one_step_unless_the_ring_ends_between_its_places(tmp_path, apart, before, expected):
    sink = open_pairs(tmp_path, 16)
    for sequence in range(before):
        sink.record(1, 1, sequence, 41)
    for sequence in range(9):
        sink.record_and_stamp(PAIR, 1, sequence, 40, 7, 8, 9, 2)
        sink.write_run(run(state="started"))  # drains the ring
    assert apart == expected
    assert pairs_of(sink)[1] == [(sequence, 42, 0) for sequence in range(9)]


def with_free_places(folder, free):
    """A sink of eight slots, three of which are used a second time, with so many free; its draining thread stands still."""
    sink = open_pairs(folder, 8)
    for sequence in range(3):
        sink.record(1, 1, sequence, 41)
    sink.write_run(run(state="started"))  # drains the ring
    sink._write_lock.acquire()
    for sequence in range(3, 11 - free):
        sink.record(1, 1, sequence, 41)
    return sink


@pytest.mark.parametrize(("free", "arrived", "left"), [(2, [0], [0]), (1, [0], []), (0, [], [])])
def test_a_pair_in_a_full_ring_takes_no_place_of_another_event(tmp_path, free, arrived, left):
    sink = with_free_places(tmp_path, free)
    assert sink.record_and_stamp(PAIR, 1, 0, 40, 7, 8, 9, 2) == 42
    assert sink.dropped_events == 2 - free
    sink._write_lock.release()
    stages = read_trace(sink.close().path).events
    assert stages[Stage.T1].sequence.tolist() == list(range(11 - free))
    assert [stages[stage].sequence.tolist() if stage in stages else [] for stage in (Stage.T3, Stage.T4)] == [
        arrived,
        left,
    ]


@pytest.mark.parametrize(("free", "is_expected"), [(3, True), (2, True), (1, False), (0, False)])
def test_a_pair_is_expected_where_both_places_are_free(tmp_path, free, is_expected):
    sink = with_free_places(tmp_path, free)
    expected = sink.expect(PAIR, 1, 0, 9, 2)
    assert (expected is not None) is is_expected
    if expected:
        assert sink.record_expected(expected, 40, 7, 8)
    sink._write_lock.release()
    stages = read_trace(sink.close().path).events
    assert stages[Stage.T1].sequence.tolist() == list(range(11 - free))
    if expected:
        assert [fields_of(stages[stage]) for stage in (Stage.T3, Stage.T4)] == [
            [(0, 40, 0, 7, 8, 9)],
            [(0, 42, 0, 0, 0, 9)],
        ]


@pytest.mark.parametrize(("before", "is_expected"), [(6, True), (7, False), (8, True)])
def test_a_pair_is_expected_unless_the_ring_ends_between_its_places(tmp_path, before, is_expected):
    sink = open_pairs(tmp_path, 8)
    for sequence in range(before):
        sink.record(1, 1, sequence, 41)
        sink.write_run(run(state="started"))  # drains the ring
    assert (sink.expect(PAIR, 1, 0, 9, 2) is not None) is is_expected
    sink.close()


@pytest.mark.parametrize("act", ["stamp", "record_and_stamp", "record_expected"])
def test_only_time_and_mark_are_missing_when_the_clock_is_read(tmp_path, act):
    """Words of the event's slot at that instant: without a mark it is none."""
    opened, seen = [], []

    def clock_ns():
        seen.extend(sink._words[SLOT_WORDS : 2 * SLOT_WORDS].tolist() for sink in opened)
        return 42

    destination = TraceDestination(tmp_path / "a.mcap", ring_slots=64, chunk_seconds=3600.0)
    sink = TraceSink(destination, ping_session(state="open"), clock_ns=clock_ns)
    opened.append(sink)
    if act == "stamp":
        sink.record(1, 1, 4, 40)
        assert sink.stamp(1, 1, 5, 3, 7, 8, 9, 2) == 42
    elif act == "record_and_stamp":
        assert sink.record_and_stamp(PAIR, 1, 5, 40, 7, 8, 9, 2) == 42
    else:
        assert sink.record_expected(sink.expect(PAIR, 1, 5, 9, 2), 40, 7, 8)
    of_the_event = [3, 7, 8] if act == "stamp" else [0, 0, 0]
    assert seen == [[1, 5, 0, *of_the_event, 9 + (2 << 32), 0]]
    opened.clear()
    sink.close()


@pytest.mark.parametrize("act", ["stamp", "record_and_stamp", "record_expected"])
def test_what_lies_in_the_ring_is_read_before_it_is_in_the_file(tmp_path, act):
    sink = open_pairs(tmp_path)
    for sequence in range(3):
        if act == "stamp":
            sink.record(3, 1, sequence, 40)
            sink.stamp(4, 1, sequence)
        elif act == "record_and_stamp":
            sink.record_and_stamp(PAIR, 1, sequence, 40, 0, 0, 0, 0)
        else:
            assert sink.record_expected(sink.expect(PAIR, 1, sequence, 0, 0), 40, 0, 0)
    stages = read_trace(tmp_path / "pairs.mcap").events
    assert [fields_of(stages[stage]) for stage in (Stage.T3, Stage.T4)] == [
        [(sequence, 40, 0, 0, 0, 0) for sequence in range(3)],
        [(sequence, 42, 0, 0, 0, 0) for sequence in range(3)],
    ]
    assert [stages[stage].relay_id.tolist() for stage in (Stage.T3, Stage.T4)] == [[0] * 3] * 2
    sink.close()


def test_an_expected_pair_has_neither_times_nor_marks(tmp_path):
    sink = open_pairs(tmp_path)
    assert sink.expect(PAIR, 1, 5, 9, 2) is not None
    assert sink._words[: 2 * SLOT_WORDS].tolist() == [1, 5, 0, 0, 0, 0, 9 + (2 << 32), 0] * 2
    assert pairs_of(sink) == [[], []]


def test_an_arrival_out_of_range_is_dropped_with_its_departure(tmp_path):
    sink = TraceSink(TraceDestination(tmp_path / "a.mcap"), ping_session(state="open"), clock_ns=lambda: 42)
    assert sink.record_and_stamp((3, 4), 1, 1 << 64, 40, 0, 0, 9, 2) == 42
    closed = sink.close()
    assert (closed.events, closed.dropped_events) == (0, 2)


@pytest.mark.keeps(1)
@pytest.mark.parametrize("method", ["write_run", "close"])
def test_killed_at_instructions_of_a_chunk(tmp_path, method):
    kept = kept_after_kills(tmp_path, method, 23)
    assert len(kept) > 40
    assert all(events == EARLIER for events in kept)


def test_killed_at_instructions_of_the_step_to_another_file(tmp_path):
    """Two whole traces, or one: every event is in one of them, once, and the second is not before the first."""
    states = set()
    for number in kill(tmp_path, "go_on_in", 97):
        old, new = (tmp_path / f"{number}" / name for name in ("a.mcap", "b.mcap"))
        earlier = read_trace(old)
        assert earlier.events[Stage.T1].sequence.tolist() == list(range(BEFORE))
        try:
            later = read_trace(new).events[Stage.T1].sequence.tolist()
        except TraceError:  # not yet there, or killed before the first word in it
            later = None
        assert later in (None, [], [BEFORE])
        is_whole = earlier.sessions[-1].state == "closed" and not ring_path(old).exists()
        states.add((later, is_whole) if later is None else (tuple(later), is_whole))
    assert states >= {(None, False), ((), False), ((BEFORE,), True)}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("method", ["write_run", "close"])
def test_killed_at_every_instruction_of_a_chunk(tmp_path, method):
    kept = kept_after_kills(tmp_path, method, 1)
    assert all(events == EARLIER for events in kept)


@pytest.mark.parametrize("stride", [61, pytest.param(1, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_killed_while_it_is_opened(tmp_path, stride):
    """What is left is read or refused in one line, and the next recording finds its place with `force`."""
    outcomes, refusals = set(), []
    for number in kill(tmp_path, "open", stride):
        path = tmp_path / f"{number}" / "a.mcap"
        try:
            report = recover(path, path.with_name("whole.mcap"))
        except TraceError as err:
            outcomes.add("refused")
            refusals.append(str(err))
        else:
            outcomes.add("recovered")
            assert (report.file_events, report.ring_events, report.damaged_chunks) == (0, 0, 0)
        again = TraceSink(TraceDestination(path, force=True), ping_session(state="open"))
        assert again.close().error is None
    assert outcomes == {"refused", "recovered"}
    assert [text for text in refusals if "\n" in text] == []


CALLS = ["fstat", "pwritev", "fsync"]
FAULTS = [errno.ENOSPC, errno.EIO, errno.EROFS, errno.ENOENT, errno.EDQUOT]


@pytest.mark.keeps(17)
@pytest.mark.parametrize("fault", FAULTS, ids=errno.errorcode.get)
@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("failing", range(6))
def test_every_call_of_the_system_fails_once(tmp_path, monkeypatch, name, fault, failing):
    """The calls of a second chunk, a description, the closed session and the summary, one after the other."""
    path = tmp_path / "a.mcap"
    destination = TraceDestination(path, ring_slots=64, chunk_seconds=3600.0, fsync=True)
    sink = TraceSink(destination, ping_session(state="open"), clock_ns=lambda: 0)
    real, left = getattr(os, name), [failing]

    def call(*arguments):
        left[0] -= 1
        if left[0] == -1:
            raise OSError(fault, os.strerror(fault))
        return real(*arguments)

    monkeypatch.setattr(f"dds_trace.tracefile.writing.writer.os.{name}", call)
    for sequence in range(30):
        sink.record(1, 1, sequence, 1000 + sequence)
        if sequence in (10, 20):
            sink.write_run(run(state="started"))
    closed = sink.close()
    monkeypatch.undo()
    assert closed.dropped_events == 0
    assert closed.events + closed.ring_events == 30
    assert (closed.error is not None) == (left[0] < 0)
    assert read_trace(path).events[Stage.T1].sequence.tolist() == list(range(30))
    if ring_path(path).exists():
        recover(path)
        assert read_trace(path).events[Stage.T1].sequence.tolist() == list(range(30))


def test_a_clock_that_jumps_changes_no_event(tmp_path):
    """A monotonic clock that steps back (a virtual machine): stamps stay as read, log times never run backwards."""
    times_ns = [5_000, 9_000_000_000, 10, 7_000]
    readings = iter([0, *times_ns])
    sink = TraceSink(
        TraceDestination(tmp_path / "a.mcap", chunk_seconds=3600.0),
        ping_session(state="open"),
        clock_ns=lambda: next(readings, 7_000),
    )
    assert [sink.stamp(1, 1, sequence) for sequence in range(4)] == times_ns
    assert sink.close().error is None
    trace = read_trace(tmp_path / "a.mcap")
    assert trace.events[Stage.T1].monotonic_ns.tolist() == times_ns
    assert trace.truncated is None


@pytest.mark.parametrize("values", [(6, 1, 0), (1, -1, 0), (1, 1 << 64, 0), (1, 1, 0, 1 << 63), (1, None, 0)])
def test_an_event_out_of_range_is_dropped_and_still_stamped(tmp_path, values):
    sink = TraceSink(TraceDestination(tmp_path / "a.mcap"), ping_session(state="open"), clock_ns=lambda: 42)
    assert sink.stamp(*values) == 42
    assert sink.stamp(1, 1, 0) == 42
    closed = sink.close()
    assert (closed.events, closed.dropped_events) == (1, 1)
    assert sink.stamp(1, 1, 1) == 42  # closed: dropped


def test_a_full_ring_stamps_without_keeping(tmp_path):
    destination = TraceDestination(tmp_path / "a.mcap", ring_slots=8, chunk_seconds=3600.0)
    sink = TraceSink(destination, ping_session(state="open"), clock_ns=lambda: 42)
    sink._write_lock.acquire()  # the draining thread stands still
    assert [sink.stamp(1, 1, sequence) for sequence in range(10)] == [42] * 10
    sink._write_lock.release()
    closed = sink.close()
    assert (closed.events, closed.dropped_events) == (8, 2)
