import errno
import json
import os
import shutil
import subprocess
import sys

import full_disk_recorder
import limited_sinks
import pytest
from limited_sinks import open_sink, sequences, stamp
from trace_files import run

from dds_trace.base.errors import OutputError, OutputExistsError
from dds_trace.extensions.bags.recover_trace import recover
from dds_trace.tracefile.format.encoding import MAGIC
from dds_trace.tracefile.reading.reader import read_trace


@pytest.mark.parametrize("scenario", limited_sinks.SCENARIOS)
def test_a_limit_of_the_size_of_files(tmp_path, scenario):
    ended = subprocess.run(
        [sys.executable, limited_sinks.__file__, scenario, tmp_path],
        stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    assert (ended.returncode, ended.stderr) == (0, "")


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


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES])
def test_a_folder_that_may_not_be_written(tmp_path, monkeypatch, number):
    if number == errno.EACCES and os.geteuid() != 0:
        tmp_path.chmod(0o500)
    else:  # root may write everywhere
        monkeypatch.setattr(
            "dds_trace.tracefile.writing.writer.os.open", lambda *_: (_ for _ in ()).throw(OSError(number, "no"))
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


def truncate(path):
    path.write_bytes(b"")


def replace(path):
    other = path.with_name("other")
    other.write_bytes(path.read_bytes())
    other.replace(path)


def rotate(path):
    path.rename(path.with_name("a.mcap.1"))
    path.write_bytes(b"")


def copy_onto(path):
    path.write_bytes(bytes(path.stat().st_size))


def append(path):
    with path.open("ab") as file:
        file.write(b"x")


@pytest.mark.parametrize("act", [truncate, rotate, copy_onto, append, replace])
@pytest.mark.parametrize("further", [0, 100])
def test_another_program_that_changes_the_file_is_an_error(tmp_path, act, further):
    path = tmp_path / "a.mcap"
    sink = open_sink(path)
    stamp(sink, 0, 100)
    sink.write_run(run(state="started"))
    act(path)
    stamp(sink, 100, 100 + further)
    closed = sink.close()
    assert closed.error is not None
    assert ("another program" if act is not replace else "deleted") in str(closed.error)
    assert closed.ring_events == further


def test_a_change_during_the_last_write_is_an_error(tmp_path, monkeypatch):
    path = tmp_path / "a.mcap"
    sink = open_sink(path)
    real = os.pwritev

    def write(descriptor, parts, offset):
        if parts[-1] == MAGIC:
            truncate(path)
        return real(descriptor, parts, offset)

    monkeypatch.setattr(os, "pwritev", write)
    assert "another program" in str(sink.close().error)


def test_force_leaves_a_living_recording_alone(tmp_path):
    sink = open_sink(tmp_path / "a.mcap")
    stamp(sink, 0, 100)
    with pytest.raises(OutputExistsError, match="still being recorded"):
        open_sink(tmp_path / "a.mcap", force=True)
    assert sink.close().error is None
    assert sequences(tmp_path / "a.mcap") == list(range(100))
    open_sink(tmp_path / "a.mcap", force=True).close()


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
    from dds_trace.base.files import output_error

    text = str(output_error(tmp_path, OSError(errno.EIO, "Input/output error")))
    assert str(tmp_path) in text
    assert "check the disk" in text
