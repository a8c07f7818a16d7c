import shutil

import pytest
from record_reader import rows
from trace_files import Message, ping_events, ping_session, relay_session

from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import iter_event_batches, read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

NUMBERS = {Stage.T1: 1, Stage.T2: 2}


def record(sink, events):
    tagged = [(fields[2], NUMBERS[stage], fields) for stage, held in events.items() for fields in held]
    for _, number, fields in sorted(tagged):
        sink.record(number, *fields)


@pytest.fixture
def killed(tmp_path):
    """A function that gives what lies on disk at the instant of a kill: some events in chunks, the rest in the ring."""
    sinks = []

    def make(in_file, in_ring, name="t.mcap"):
        sink = TraceSink(TraceDestination(tmp_path / "live" / name, chunk_seconds=3600), ping_session(state="open"))
        sinks.append(sink)
        record(sink, in_file)
        sink.write_json("/dds_trace/note", {"now": "everything before goes to the file"})
        record(sink, in_ring)
        target = tmp_path / "killed" / name
        target.parent.mkdir(exist_ok=True)
        shutil.copy(ring_path(tmp_path / "live" / name), ring_path(target))
        shutil.copy(tmp_path / "live" / name, target)
        return target

    (tmp_path / "live").mkdir()
    yield make
    for sink in sinks:
        sink.close()


ALL = ping_events([Message(n, t0=n * 1000, t1=n * 1000 + 7, t2=n * 1000 + 500) for n in range(300)])


def part(start, stop):
    return {stage: held[start:stop] for stage, held in ALL.items()}


@pytest.mark.parametrize("in_file", [0, 1, 120, 300])
def test_file_and_ring_together_hold_every_event_once(killed, in_file):
    trace = read_trace(killed(part(0, in_file), part(in_file, 300)))
    assert {stage: rows(columns) for stage, columns in trace.events.items()} == {
        stage: ALL.get(stage, []) for stage in Stage
    }
    assert trace.truncated
    assert (trace.sessions, trace.notes) == ((ping_session(state="open"),), ())


def test_how_many_came_from_the_ring_is_said(killed):
    path = killed(part(0, 120), part(120, 300))
    trace = read_trace(path)
    ring_path(path).unlink()
    alone = read_trace(path)
    assert trace.event_count == 600
    assert trace.ring_events == 600 - alone.event_count == 360
    assert alone.ring_events == 0


def test_a_file_cut_off_further_loses_nothing_that_the_ring_still_has(killed):
    path = killed(part(0, 120), part(120, 300))
    whole = path.read_bytes()
    for size in range(0, len(whole), 97):
        path.write_bytes(whole[:size])
        trace = read_trace(path)
        assert trace.event_count == 600
        assert trace.sessions[0].session_id == ping_session().session_id


def test_batches_know_the_ring_too(killed):
    path = killed(part(0, 120), part(120, 300))
    assert sum(len(columns) for _, columns in iter_event_batches(path)) == 600


def test_a_ring_that_cannot_be_read_is_noted_and_the_file_is_used(killed):
    path = killed(part(0, 120), part(120, 300))
    ring_path(path).write_bytes(b"nonsense" * 100)
    trace = read_trace(path)
    assert trace.event_count <= 600
    assert "its ring is not used" in trace.notes[0]


def test_a_trace_that_is_still_being_recorded_is_read_up_to_now(tmp_path):
    sink = TraceSink(TraceDestination(tmp_path / "t.mcap", chunk_seconds=3600), relay_session(state="open"))
    try:
        sink.record(3, 1, 0, 5)
        trace = read_trace(tmp_path / "t.mcap")
        assert trace.event_count == 1
        assert any("still being recorded" in note for note in trace.notes)
    finally:
        sink.close()
    assert read_trace(tmp_path / "t.mcap").notes == ()
