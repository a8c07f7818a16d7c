import errno
import os
from dataclasses import replace

import pytest

from dds_trace.base.errors import OptionError, OutputError, TraceFormatError
from dds_trace.extensions.campaigns.folder import replace_text
from dds_trace.extensions.campaigns.run.result import CellResult
from dds_trace.extensions.campaigns.run.state import CellState, Status, SweepState

RESULT = CellResult(
    run_id="ff",
    planned=4,
    published=4,
    received=3,
    sent_bytes=132_000,
    achieved_rate_hz=10.0,
    rtt_ms={"p50": 1.5},
    response_ms=None,
    dropped_events=0,
    cut_off=False,
)
COUNTERS = {"sent_bytes": 140_000, "sent_packets": 100, "dropped_packets": 0}
LINK = {
    "monotonic_ns": 7,
    "link": {"name": "wifi-54", "rate_mbit_s": 54.0},
    "applied_by": "veth+tbf",
    "commands": ["tc qdisc add"],
    "ping": COUNTERS,
    "relay": COUNTERS,
    "forwarder": None,
}


def open_state(folder, digest="d1"):
    return SweepState(folder / "state.json", "plan", digest)


def test_state_comes_back_as_it_was_left(tmp_path):
    state = open_state(tmp_path)
    assert state["a"].status is Status.PENDING
    state["a"] = CellState(Status.RUNNING, attempts=1)
    state["b"] = CellState(Status.RECORDED, run_id="ff", segment="1-17-1.mcap", result=RESULT, link=LINK)
    again = open_state(tmp_path)
    assert again["a"] == state["a"]
    assert again["b"] == state["b"]
    assert again.segments == ["1-17-1.mcap"]
    assert list(again.in_segment("1-17-1.mcap")) == ["b"]
    assert [again[name].done for name in "abc"] == [False, True, False]


def test_other_settings_of_the_plan_are_not_mixed_in(tmp_path):
    open_state(tmp_path)["a"] = CellState(Status.COMPLETE)
    with pytest.raises(OptionError, match="different runs are not mixed"):
        open_state(tmp_path, digest="d2")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        *((text, "not the state") for text in ("", "{", "[]", '{"format": 1}', "[" * 100_000)),
        ('{"format": 1, "plan_digest": "d1", "cells": 3}', "not the state"),
        ('{"format": 2, "plan_digest": "d1", "cells": {}}', "format 2"),
        (None, "not a regular file"),
    ],
)
def test_file_that_is_no_state_of_this_version(tmp_path, text, word):
    if text is None:
        os.mkfifo(tmp_path / "state.json")
    else:
        (tmp_path / "state.json").write_text(text)
    with pytest.raises(TraceFormatError, match=rf"state\.json.*{word}"):
        open_state(tmp_path)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("../../important", {}),
        ("/etc/important", {}),
        (".hidden", {"segment": "", "run_id": ""}),
        ("", {"segment": "", "run_id": ""}),
        *(("a", {"segment": name}) for name in ("../../home/thesis", "*", "-rf.mcap", "1-17-1.mcap; reboot")),
        ("a", {"segment": "1-17-1.mcap\n"}),
        *(("a", {"run_id": value}) for value in ("no hex", "", 5, ["a"], {}, {"b": 1})),
    ],
)
def test_names_that_no_sweep_gives_are_refused(tmp_path, name, changes):
    recorded = CellState(Status.RECORDED, run_id="ff", segment="1-17-1.mcap")
    open_state(tmp_path)[name] = replace(recorded, **changes)
    with pytest.raises(TraceFormatError, match="not the state of a sweep"):
        open_state(tmp_path)


def test_interrupted_write_leaves_the_state_before(tmp_path, monkeypatch):
    state = open_state(tmp_path)
    state["a"] = CellState(attempts=1)

    def stop(_descriptor):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", stop)
    with pytest.raises(KeyboardInterrupt):
        state["a"] = CellState(attempts=2)
    monkeypatch.undo()
    assert open_state(tmp_path)["a"].attempts == 1


def test_state_is_for_owner_and_group(tmp_path):
    before = os.umask(0)
    try:
        replace_text(tmp_path / "state.json", "{}")
    finally:
        os.umask(before)
    assert (tmp_path / "state.json").stat().st_mode & 0o777 == 0o640


def test_folder_that_cannot_be_written_is_a_clear_error(tmp_path):
    with pytest.raises(OutputError, match="its folder was deleted or moved") as gone:
        replace_text(tmp_path / "none" / "state.json", "{}")
    assert list(tmp_path.iterdir()) == []
    assert "space" not in str(gone.value)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "the disk is full; free space"),
        (errno.EROFS, "the file system is read-only; choose another --out"),
        (errno.EIO, "Input/output error; check the disk"),
    ],
)
def test_a_state_that_cannot_be_written_says_what_helps(tmp_path, monkeypatch, number, words):
    def fail(*_arguments):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("dds_trace.extensions.campaigns.folder.create_file", fail)
    with pytest.raises(OutputError, match=f"cannot write the state of the sweep: {words}"):
        replace_text(tmp_path / "state.json", "{}")
