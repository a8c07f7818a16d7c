"""The traces in a folder, found by the names of their files."""

from __future__ import annotations

import pytest

from dds_trace.base.errors import MissingEventsError
from dds_trace.tracefile.reading.storage import find_traces


def test_files_and_bags_are_found_below_and_sorted(tmp_path):
    for name in (
        "b.mcap",
        "a/z.mcap",
        "bag/bag_0.mcap",
        "bag/metadata.yaml",
        "a/old/old_0.db3",
        "a/old/metadata.yaml",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "b.mcap.ring").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "metadata.yaml").write_text("")
    found = [str(path.relative_to(tmp_path)) for path in find_traces(tmp_path)]
    assert found == ["a/old", "a/z.mcap", "b.mcap", "bag"]


def test_skipped_folders_and_files_are_left_out(tmp_path):
    for name in ("keep.mcap", "drop.mcap", "analysis/own.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "again.mcap").symlink_to(tmp_path / "drop.mcap")
    (tmp_path / "by_a_link").symlink_to(tmp_path, target_is_directory=True)
    skip = [tmp_path / "analysis", tmp_path / "x" / ".." / "drop.mcap"]
    assert find_traces(tmp_path / "by_a_link", skip=skip) == [tmp_path / "by_a_link" / "keep.mcap"]
    assert find_traces(tmp_path, skip=skip) == [tmp_path / "keep.mcap"]


def test_a_trace_is_found_in_itself(tmp_path):
    (tmp_path / "x.mcap").write_text("")
    assert find_traces(tmp_path / "x.mcap") == [tmp_path / "x.mcap"]
    (tmp_path / "metadata.yaml").write_text("")
    assert find_traces(tmp_path) == [tmp_path]


def test_no_folder_is_an_error(tmp_path):
    with pytest.raises(MissingEventsError, match="nowhere"):
        find_traces(tmp_path / "nowhere")
