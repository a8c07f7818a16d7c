"""Traces, rings and metadata are the owner's, and the group's to read: from the first instant, whatever the umask is."""

from __future__ import annotations

import os
import stat

import pytest
from trace_files import ping_session

from dds_trace.base.files import create_file
from dds_trace.tracefile.recovery.recover import recover
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

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
def test_a_recovered_trace_has_the_rights_of_what_it_is_made_of(
    tmp_path, with_umask, original, recovered, left
):
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
