import contextlib
import os
import time
from pathlib import Path

import pytest

from dds_trace.base import files
from dds_trace.base.files import MOST_SETTINGS_BYTES, read_regular, remove_drafts, replacing


def test_the_draft_takes_the_place_of_the_old_file(tmp_path):
    path = tmp_path / "state.json"
    path.write_text("old")
    with replacing(path, fsync=True) as draft:
        draft.write_text("new")
        assert path.read_text() == "old"
        assert (draft.parent, draft.suffix) == (tmp_path, ".part")
    assert path.read_text() == "new"
    assert [file.name for file in tmp_path.iterdir()] == ["state.json"]


def test_an_error_leaves_the_old_file_and_no_draft(tmp_path):
    path = tmp_path / "state.json"
    path.write_text("old")

    def fail_half_way():
        with replacing(path) as draft:
            draft.write_text("ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail_half_way()
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["state.json"]


def test_a_link_is_replaced_and_its_target_left_alone(tmp_path):
    target = tmp_path / "target.json"
    target.write_text("somebody else's")
    path = tmp_path / "state.json"
    path.symlink_to(target)
    with replacing(path) as draft:
        draft.write_text("ours")
    assert target.read_text() == "somebody else's"
    assert not path.is_symlink()
    assert path.read_text() == "ours"


def test_two_writers_of_one_file_have_a_draft_each(tmp_path):
    path = tmp_path / "roundtrips.parquet"
    with replacing(path) as later:
        later.write_text("later")
        with replacing(path) as sooner:
            sooner.write_text("sooner")
        assert path.read_text() == "sooner"
    assert path.read_text() == "later"


def test_a_folder_that_is_gone_is_an_os_error(tmp_path):
    def write():
        with replacing(tmp_path / "none" / "state.json") as draft:
            draft.write_text("{}")

    with pytest.raises(FileNotFoundError):
        write()


def test_a_draft_that_cannot_take_its_place_is_removed(tmp_path):
    (tmp_path / "state.json").mkdir()

    def write():
        with replacing(tmp_path / "state.json") as draft:
            draft.write_text("{}")

    with pytest.raises(IsADirectoryError):
        write()
    assert [file.name for file in tmp_path.iterdir()] == ["state.json"]


def test_drafts_of_a_dead_process_are_removed_and_nothing_else(tmp_path):
    others = ["a.csv.0123abcd.part", "report.html", "report.html.part", "report.html.0123ABCD.part"]
    for name in [*others, "report.html.0123abcd.part"]:
        (tmp_path / name).write_text("")
    (tmp_path / "report.html.00000000.part").symlink_to(tmp_path / "report.html")
    remove_drafts(tmp_path, ["report.html"])
    assert {file.name for file in tmp_path.iterdir()} == {*others, "report.html.00000000.part"}


def test_no_draft_is_removed_while_one_is_written(tmp_path):
    with replacing(tmp_path / "report.html") as draft:
        draft.write_text("new")
        remove_drafts(tmp_path, ["report.html"])
        assert draft.exists()
    assert (tmp_path / "report.html").read_text() == "new"


def test_a_folder_that_is_missing_has_no_drafts(tmp_path):
    remove_drafts(tmp_path / "missing", ["report.html"])


@pytest.mark.parametrize("path", ["/dev/zero", "pipe", "large"])
def test_settings_are_a_regular_file_of_bounded_size(tmp_path, path):
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(MOST_SETTINGS_BYTES + 1)
    with pytest.raises(OSError, match=r"not a regular file|larger than"):
        read_regular(tmp_path / path)
    (tmp_path / "small").write_bytes(b"<dds/>")
    assert read_regular(tmp_path / "small") == b"<dds/>"


def test_a_device_and_a_pipe_are_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/null"), Path("/dev/stdout")):
        before = path.lstat().st_mode
        with pytest.raises(OSError, match="device or a pipe"), replacing(path):
            pass
        assert path.lstat().st_mode == before


@pytest.mark.skipif(os.geteuid() != 0, reason="root")
@pytest.mark.parametrize(("user", "expected"), [("64321", 64321), ("", 0), ("-1", 0), ("root", 0)])
@pytest.mark.parametrize("raises", [False, True])
def test_what_root_writes_belongs_to_the_user_who_called_sudo(tmp_path, monkeypatch, user, expected, raises):
    monkeypatch.setenv("SUDO_UID", user)
    monkeypatch.setenv("SUDO_GID", user)
    (tmp_path / "old").write_text("root's")
    os.utime(tmp_path / "old")
    for name in ("link", "second"):
        (tmp_path / f"{name}.target").write_text("root's")
    time.sleep(0.2)
    out = tmp_path / "made" / "runs"
    with contextlib.suppress(KeyError), files.given_to_caller(out):
        (out / "deep").mkdir(parents=True)
        (out / "deep" / "trace.mcap").write_text("new")
        (out / "link").symlink_to(tmp_path / "link.target")
        (out / "second").hardlink_to(tmp_path / "second.target")
        if raises:
            raise KeyError
    for path in (out.parent, out, out / "deep", out / "deep" / "trace.mcap"):
        assert path.stat().st_uid == path.stat().st_gid == expected
    for path in (tmp_path, tmp_path / "old", tmp_path / "link.target", tmp_path / "second.target"):
        assert path.stat().st_uid == 0
    with files.given_to_caller(tmp_path):  # one that was there
        (tmp_path / "new").write_text("new")
    assert [(tmp_path / name).stat().st_uid for name in ("new", "old", ".")] == [expected, 0, 0]
