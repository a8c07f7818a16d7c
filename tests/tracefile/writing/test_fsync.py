"""With `fsync` chunks, files and their names are on the disk; `tests/cli/record/test_power_loss.py` takes the power away."""

from __future__ import annotations

from pathlib import Path

from trace_files import ping_session

from dds_trace.tracefile import TraceDestination, TraceSink


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
