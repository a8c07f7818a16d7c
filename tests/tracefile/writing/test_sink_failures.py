"""Writing fails: a clear error is kept, recording goes on without raising, what was written stays readable."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import full_disk_recorder
import pytest
from trace_files import ping_session, run

from dds_trace.tracefile import OutputError, Stage, TraceDestination, TraceSink
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.recovery.recover import recover

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NEVER_S = 3600.0


def open_sink(path: Path, **options) -> TraceSink:
    destination = TraceDestination(path, **{"chunk_seconds": NEVER_S, **options})
    return TraceSink(destination, ping_session(state="open"), clock_ns=lambda: 0)


def stamp(sink: TraceSink, first: int, end: int) -> None:
    for sequence in range(first, end):
        sink.record(1, 1, sequence, 1000 * sequence)


def sequences(path: Path) -> list[int]:
    return read_trace(path).events[Stage.T1].sequence.tolist()


@pytest.fixture
def file_size_limit() -> Iterator:
    """Set the largest size that a file may grow to; the system's own limit comes back afterwards."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_is_full_in_the_middle_of_a_chunk(tmp_path, file_size_limit):
    path = tmp_path / "a.mcap"
    sink = open_sink(path, ring_slots=9000)  # a quarter is more than is pending before the disk is full
    stamp(sink, 0, 1000)
    sink.write_run(run(state="started"))
    size = path.stat().st_size
    stamp(sink, 1000, 3000)
    file_size_limit(size + 100)
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


def test_writing_goes_on_when_there_is_room_again(tmp_path, file_size_limit):
    path = tmp_path / "a.mcap"
    sink = open_sink(path)
    file_size_limit(path.stat().st_size + 10)
    stamp(sink, 0, 500)
    sink.write_run(run(state="started"))
    error = sink.error
    assert error is not None
    file_size_limit(resource.RLIM_INFINITY)
    stamp(sink, 500, 600)
    closed = sink.close()
    assert (closed.events, closed.ring_events, closed.dropped_events) == (600, 0, 0)
    assert closed.error is error  # said, although all is well now
    assert not ring_path(path).exists()
    trace = read_trace(path)
    assert trace.truncated is None
    assert [described.run_id for described in trace.runs] == [run().run_id]


def test_a_real_disk_that_is_full(tmp_path):
    folder, report = tmp_path / "disk", tmp_path / "report.json"
    folder.mkdir()
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rm", "true"], check=False).returncode:
        pytest.skip("no mount namespace may be made here (unshare -rm)")
    subprocess.run(
        ["unshare", "-rm", sys.executable, full_disk_recorder.__file__, str(folder), str(report)], check=True
    )
    told = json.loads(report.read_text())
    left = tmp_path / "left" / "a.mcap"
    assert "the disk is full" in told["error"]
    assert told["events"] + told["ring_events"] + told["dropped_events"] == told["stamped"]
    assert told["events"] > 0
    assert 0 < told["ring_events"] <= full_disk_recorder.RING_SLOTS  # a last small chunk may have fitted
    found = sequences(left)
    assert len(found) == told["events"] + told["ring_events"]
    assert found[: told["events"]] == list(range(told["events"]))
    report_of_recovery = recover(left, tmp_path / "whole.mcap")  # on a disk with room
    assert report_of_recovery.dropped_events == told["dropped_events"]
    assert sequences(tmp_path / "whole.mcap") == found
    assert read_trace(tmp_path / "whole.mcap").sessions[0].dropped_events == told["dropped_events"]


def test_no_room_for_the_ring_at_the_start(tmp_path, file_size_limit):
    file_size_limit(10_000)
    with pytest.raises(OutputError, match="ring"):
        open_sink(tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


def test_no_room_at_all_at_the_start(tmp_path, file_size_limit):
    file_size_limit(4)
    with pytest.raises(OutputError, match="cannot write"):
        open_sink(tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES])
def test_a_folder_that_may_not_be_written(tmp_path, monkeypatch, number):
    if number == errno.EACCES and os.geteuid() != 0:
        tmp_path.chmod(0o500)
    else:  # root may write everywhere
        monkeypatch.setattr(
            "dds_trace.tracefile.writing.writer.os.open",
            lambda *_: (_ for _ in ()).throw(OSError(number, "no")),
        )
    with pytest.raises(OutputError, match="choose another --out"):
        open_sink(tmp_path / "a.mcap")


def test_a_path_through_a_file(tmp_path):
    (tmp_path / "a.mcap").write_text("")
    with pytest.raises(OutputError, match="choose another --out"):
        open_sink(tmp_path / "a.mcap" / "b.mcap")


@pytest.mark.parametrize("name", ["a.mcap", "bag"])
def test_a_folder_that_vanishes(tmp_path, name):
    folder = tmp_path / "usb"
    sink = open_sink(folder / name, ring_slots=500)
    stamp(sink, 0, 100)
    sink.write_run(run(state="started"))
    shutil.rmtree(folder)
    stamp(sink, 100, 700)
    sink.write_run(run(state="finished"))
    assert "deleted or moved" in str(sink.error)
    closed = sink.close()
    assert (closed.events, closed.ring_events, closed.dropped_events) == (100, 500, 100)
    assert closed.error is sink.error


def test_a_folder_that_moves_is_still_written(tmp_path):
    sink = open_sink(tmp_path / "here" / "a.mcap")
    stamp(sink, 0, 100)
    (tmp_path / "here").rename(tmp_path / "there")
    closed = sink.close()
    assert (closed.events, closed.error) == (100, None)
    assert sequences(tmp_path / "there" / "a.mcap") == list(range(100))


def test_metadata_that_cannot_be_written(tmp_path):
    sink = open_sink(tmp_path / "bag")
    stamp(sink, 0, 10)
    (tmp_path / "bag" / "metadata.yaml").mkdir()
    closed = sink.close()
    assert "metadata.yaml" in str(closed.error)
    assert sequences(tmp_path / "bag" / "bag_0.mcap") == list(range(10))


def test_every_error_number_says_what_to_do(tmp_path):
    from dds_trace.tracefile.files import output_error

    text = str(output_error(tmp_path, OSError(errno.EIO, "Input/output error")))
    assert str(tmp_path) in text
    assert "check the disk" in text
