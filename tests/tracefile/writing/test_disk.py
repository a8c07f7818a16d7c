import json
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import dying_disk
import pytest
from forgetful_disk import missing_for_a_disk
from trace_files import ping_session

from dds_trace.base.files import create_file
from dds_trace.extensions.bags.recover_trace import recover
from dds_trace.tracefile.format.events import Stage
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
    assert folders == [(Path(), ["runs"]), (Path("runs"), ["bag"]), (bag, ["bag_0.mcap", "bag_0.mcap.ring"])]
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
def test_the_longest_time_that_an_event_was_not_on_the_disk_is_in_the_closed_session(tmp_path, monkeypatch, fsync):
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


RIGHTS = {  # umask, mode -> rights of files, of the bag's folder
    (0o000, 0o640): (0o640, 0o750),
    (0o000, 0o600): (0o600, 0o700),
    (0o022, 0o640): (0o640, 0o750),
    (0o077, 0o640): (0o600, 0o700),
    (0o077, 0o600): (0o600, 0o700),
}


@pytest.fixture
def with_umask():
    """A function that sets the umask; the one from before comes back afterwards."""
    before = os.umask(0)
    yield os.umask
    os.umask(before)


@pytest.fixture
def made(monkeypatch):
    """Rights of each file and folder as it was made; changing them later fails."""
    rights = {}

    def seeing(call, mode_at):
        def make(path, *arguments, **options):
            made_now = call(path, *arguments, **options)
            if len(arguments) > mode_at:
                rights[os.path.basename(path)] = stat.S_IMODE(os.stat(path).st_mode)  # noqa: PTH119, PTH116 - any path
            return made_now

        return make

    def refuse(*_):
        raise AssertionError("rights are changed after the fact")

    monkeypatch.setattr(os, "open", seeing(os.open, 1))
    for name in ("chmod", "fchmod", "lchmod"):
        monkeypatch.setattr(os, name, refuse, raising=False)
    return rights


def rights_in(folder):
    return {path.name: stat.S_IMODE(path.stat().st_mode) for path in folder.rglob("*")}


@pytest.mark.parametrize(("umask", "mode"), RIGHTS)
def test_a_recording_has_the_rights_asked_for_from_its_first_instant(tmp_path, with_umask, made, umask, mode):
    files, folder = RIGHTS[umask, mode]
    with_umask(umask)
    sink = TraceSink(TraceDestination(tmp_path / "bag", mode=mode), ping_session(state="open"))
    assert rights_in(tmp_path) == {"bag": folder, "bag_0.mcap": files, "bag_0.mcap.ring": files}
    sink.record(1, 1, 0, 1000)
    assert sink.close().error is None
    assert rights_in(tmp_path) == {"bag": folder, "bag_0.mcap": files, "metadata.yaml": files}
    assert set(made.values()) == {files}
    assert len(made) == 3  # trace, ring, and the draft of the metadata


def test_nothing_said_is_for_owner_and_group(tmp_path, with_umask):
    with_umask(0)
    TraceSink(TraceDestination(tmp_path / "a.mcap"), ping_session(state="open")).close()
    assert rights_in(tmp_path) == {"a.mcap": 0o640}


@pytest.mark.parametrize(("original", "recovered"), [(0o600, 0o600), (0o640, 0o640), (0o666, 0o640)])
@pytest.mark.parametrize("left", ["both", "ring"])
def test_a_recovered_trace_has_the_rights_of_what_it_is_made_of(tmp_path, with_umask, original, recovered, left):
    with_umask(0)
    path = tmp_path / "a.mcap"
    sink = TraceSink(TraceDestination(path, chunk_seconds=3600.0), ping_session(state="open"))
    sink.record(1, 1, 0, 1000)
    sink._files.ring.close(delete=False)  # the recorder is gone
    for each in tmp_path.iterdir():
        each.chmod(original)
    if left == "ring":
        path.unlink()
    recover(path)
    assert stat.S_IMODE(path.stat().st_mode) == recovered


def test_a_file_is_only_made_where_nothing_is(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileExistsError):
        create_file(tmp_path / "link")
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.skipif(missing_for_a_disk() is not None, reason=str(missing_for_a_disk()))
@pytest.mark.parametrize(("options", "words"), [(["--fsync"], "check the disk"), ([], "the file system is read-only")])
def test_the_ring_keeps_what_a_dead_disk_refuses(tmp_path, options, words):
    command = ["unshare", "-m", sys.executable, dying_disk.__file__, str(tmp_path), *options]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    told = json.loads(done.stdout.splitlines()[-1])
    events, ring_events, dropped, error = told["closed"]
    assert told["exit_code"] == 0
    assert (events + ring_events, dropped) == (dying_disk.EVENTS, 0)
    assert ring_events > 0
    assert words in error
    left = tmp_path / "left" / "a.mcap"
    assert read_trace(left).events[Stage.T1].sequence.tolist() == list(range(dying_disk.EVENTS))
    recover(left)
    assert read_trace(left).events[Stage.T1].sequence.tolist() == list(range(dying_disk.EVENTS))
