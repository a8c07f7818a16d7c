"""With `fsync` chunks, files and their names are on the disk; `tests/cli/record/test_power_loss.py` takes the power away."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from trace_files import ping_session

from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink


def test_the_names_of_new_files_and_folders_are_flushed(tmp_path, monkeypatch):
    """Content of a file whose name is not on the disk is lost with the power."""
    flushed = []

    def note(descriptor):
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        flushed.append((path, sorted(each.name for each in path.iterdir()) if path.is_dir() else None))

    monkeypatch.setattr("os.fsync", note)
    bag = Path("runs/bag")
    sink = TraceSink(TraceDestination(tmp_path / bag, fsync=True), ping_session(state="open"))
    folders = [(path.relative_to(tmp_path), names) for path, names in flushed if names is not None]
    assert folders == [
        (Path(), ["runs"]),
        (Path("runs"), ["bag"]),
        (bag, ["bag_0.mcap", "bag_0.mcap.ring"]),
    ]
    flushed.clear()
    sink.close()
    assert flushed[-1] == (tmp_path / bag, ["bag_0.mcap", "bag_0.mcap.ring", "metadata.yaml"])


def test_chunks_come_twice_as_often(tmp_path):
    """An event waits for the end of one flush and for all of the next; both together stay below the second."""
    assert TraceDestination(tmp_path / "a.mcap").flush_seconds == 1.0
    assert TraceDestination(tmp_path / "a.mcap", fsync=True).flush_seconds == 0.5


def test_without_an_event_nothing_was_unsaved(tmp_path):
    path = tmp_path / "a.mcap"
    sink = TraceSink(TraceDestination(path, fsync=True), ping_session(state="open"))
    sink.write_json("/dds_trace/host", {"cpu_percent": 1})
    sink.close()
    (session,) = read_trace(path).sessions
    assert session.extra["longest_unsaved_ns"] == 0


@pytest.mark.parametrize("fsync", [True, False])
def test_the_longest_time_that_an_event_was_not_on_the_disk_is_in_the_closed_session(
    tmp_path, monkeypatch, fsync
):
    flush_s, stamps_ns, flushed_ns = 0.05, [], []

    def slow_flush(_descriptor):
        time.sleep(flush_s)
        flushed_ns.append(time.monotonic_ns())

    monkeypatch.setattr("os.fsync", slow_flush)
    path = tmp_path / "slow.mcap"
    sink = TraceSink(TraceDestination(path, fsync=fsync, chunk_seconds=0.02), ping_session(state="open"))
    for sequence in range(100):
        stamps_ns.append(sink.stamp(1, 7, sequence, 0, 0, 0, 8, 0))
        time.sleep(0.002)
    sink.close()
    (session,) = read_trace(path).sessions
    told_ns = session.extra.get("longest_unsaved_ns")
    if not fsync:
        assert told_ns is None
        return
    # Nothing that was stamped was unsaved for longer; and some event waited for two flushes, or nearly.
    assert told_ns > 1.5 * flush_s * 1e9
    assert told_ns <= flushed_ns[-1] - stamps_ns[0] + 1_000_000_000
