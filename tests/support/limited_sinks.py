"""A process that records under a limit of the size of its files (`ulimit -f`), as on a disk that is full at that byte.

    python limited_sinks.py SCENARIO FOLDER

The limit is the whole process's, so it is never a test worker's: whatever else a worker would write in those
milliseconds (what it captured, byte code, its own report) would fail, too.
"""

import resource
import sys
from pathlib import Path

import pytest
from trace_files import ping_session, run

from dds_trace.base.errors import OutputError
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

NEVER_S = 3600.0


def limit_file_size(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def open_sink(path: Path, **options: int) -> TraceSink:
    destination = TraceDestination(path, chunk_seconds=NEVER_S, **options)
    return TraceSink(destination, ping_session(state="open"), clock_ns=lambda: 0)


def stamp(sink: TraceSink, first: int, end: int) -> None:
    for sequence in range(first, end):
        sink.record(1, 1, sequence, 1000 * sequence)


def sequences(path: Path) -> list[int]:
    return read_trace(path).events[Stage.T1].sequence.tolist()


def full_in_the_middle_of_a_chunk(path: Path) -> None:
    sink = open_sink(path, ring_slots=9000)  # a quarter is more than is pending before the disk is full
    stamp(sink, 0, 1000)
    sink.write_run(run(state="started"))
    size = path.stat().st_size
    stamp(sink, 1000, 3000)
    limit_file_size(size + 100)
    sink.write_run(run(state="finished"))
    assert isinstance(sink.error, OutputError)
    assert str(path) in str(sink.error)
    assert "ulimit" in str(sink.error)
    assert path.stat().st_size == size  # the part that fitted is cut off again
    stamp(sink, 3000, 10_100)
    closed = sink.close()
    assert (closed.events, closed.ring_events, closed.dropped_events) == (1000, 9000, 100)
    assert closed.error is sink.error
    assert sequences(path) == list(range(10_000))  # the ring is still there


def room_again(path: Path) -> None:
    sink = open_sink(path)
    limit_file_size(path.stat().st_size + 10)
    stamp(sink, 0, 500)
    sink.write_run(run(state="started"))
    error = sink.error
    assert error is not None
    limit_file_size(resource.RLIM_INFINITY)
    stamp(sink, 500, 600)
    closed = sink.close()
    assert (closed.events, closed.ring_events, closed.dropped_events) == (600, 0, 0)
    assert closed.error is error  # said, although all is well now
    assert not ring_path(path).exists()
    trace = read_trace(path)
    assert trace.truncated is None
    assert [described.run_id for described in trace.runs] == [run().run_id]


def no_room_for_the_ring(path: Path) -> None:
    limit_file_size(10_000)
    _refused(path, "ring")


def no_room_at_all(path: Path) -> None:
    limit_file_size(4)
    _refused(path, "cannot write")


def _refused(path: Path, reason: str) -> None:
    with pytest.raises(OutputError, match=reason):
        open_sink(path)
    assert list(path.parent.iterdir()) == []


SCENARIOS = {
    scenario.__name__: scenario
    for scenario in (full_in_the_middle_of_a_chunk, room_again, no_room_for_the_ring, no_room_at_all)
}

if __name__ == "__main__":
    SCENARIOS[sys.argv[1]](Path(sys.argv[2]) / "a.mcap")
