import fcntl
import json
import math
import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.model.finding import Finding, Severity
from dds_trace.analyzer.saving.records import from_json
from dds_trace.analyzer.saving.results import RESULT_NAMES, replacing_results
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.recommend import Candidate, Fit, Recommendation
from dds_trace.base.errors import OutputError
from dds_trace.base.files import folder_lock
from dds_trace.base.records import to_json

OWN = "notes.md"
FILE_EVENTS = {"open", "fcntl.flock", *(f"os.{name}" for name in ("mkdir", "listdir", "rename", "remove", "rmdir"))}
"""Audit events of what a replacement does with files."""


NAMES = (*RESULT_NAMES, "report.toy")
"""A new kind of report is replaced as the others are."""


def write(folder, text, names=NAMES):
    with replacing_results(folder) as drafts:
        for name in names:
            (drafts / name).write_text(text)


def results(folder):
    return {path.name: path.read_text() for path in folder.iterdir() if path.name in NAMES}


def killed_at(number, act):
    """Whether a process that acts is killed, at its `number`-th change or look at files."""
    pid = os.fork()
    if pid == 0:
        left = iter(range(number))

        def hook(event, _arguments):
            if event in FILE_EVENTS and next(left, None) is None:
                os.kill(os.getpid(), signal.SIGKILL)

        try:
            sys.addaudithook(hook)
            act()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == -signal.SIGKILL


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_process_that_is_killed_anywhere_leaves_results_of_one_analysis(tmp_path):
    some = NAMES[:3]
    states = set()
    for number in range(10_000):
        folder = tmp_path / str(number)
        write(folder, "old")
        (folder / OWN).write_text("mine")
        is_killed = killed_at(number, lambda folder=folder: write(folder, "new"))
        after = results(folder)
        states.add((tuple(sorted(after)), tuple(set(after.values()))))
        assert len(set(after.values())) == 1, number
        write(folder, "next", some)
        after = results(folder)
        assert after.keys() == set(NAMES)
        assert {after.pop(name) for name in some} == {"next"}
        assert len(set(after.values())) == 1, number
        assert {path.name for path in folder.iterdir()} == {*NAMES, OWN}
        assert (folder / OWN).read_text() == "mine"
        if not is_killed:
            break
    assert len(states) == 2 * len(NAMES)  # each step of the replacement was met


def test_an_error_leaves_the_earlier_results_and_no_new_folder(tmp_path):
    write(tmp_path, "old")

    def fail(folder):
        with replacing_results(folder) as drafts:
            (drafts / "report.html").write_text("new")
            raise KeyboardInterrupt

    for folder in (tmp_path, tmp_path / "new" / "folder"):
        with pytest.raises(KeyboardInterrupt):
            fail(folder)
    assert set(results(tmp_path).values()) == {"old"}
    assert {path.name for path in tmp_path.iterdir()} == set(NAMES)


def test_drafts_of_others_stay(tmp_path):
    """A living process's, one without our mark, with a folder, under another name, by a link."""
    names = ("results.00000000.part", "results.00000001.whole", "results.00000003.whole", "results.0.part", "elsewhere")
    living, _, deep, named, target = folders = [tmp_path / name for name in names]
    for folder in folders:
        folder.mkdir()
        (folder / "report.html").write_text("theirs")
    for folder in (living, deep, named, target):
        (folder / ".dds-trace").touch()
    (deep / "folder").mkdir()
    (tmp_path / "results.00000002.whole").symlink_to(target)
    with folder_lock(living, fcntl.LOCK_SH) as is_locked:
        assert is_locked
        write(tmp_path, "new")
    for folder in folders:
        assert (folder / "report.html").read_text() == "theirs"
    assert (tmp_path / "results.00000002.whole").is_symlink()


def test_a_folder_in_place_of_a_result_is_an_error_before_anything_is_replaced(tmp_path):
    write(tmp_path, "old")
    (tmp_path / "report.md").unlink()
    (tmp_path / "report.md").mkdir()
    with pytest.raises(OutputError, match=r"report\.md is a folder"):
        write(tmp_path, "new")
    (tmp_path / "report.md").rmdir()
    assert set(results(tmp_path).values()) == {"old"}
    assert not [path for path in tmp_path.iterdir() if path.name not in NAMES]


def test_a_link_is_replaced_and_its_target_left_alone(tmp_path):
    target = tmp_path / "elsewhere"
    target.write_text("theirs")
    (tmp_path / "report.md").symlink_to(target)
    write(tmp_path, "new")
    assert (target.read_text(), (tmp_path / "report.md").is_symlink()) == ("theirs", False)


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    Path(tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="--out"):
        write(tmp_path / "file" / "below", "new")


JOB = Job("binary", 33_000, 10.0, 50, 0.9)
TEXTS = st.text(max_size=5)
FLOATS = st.none() | st.floats(allow_nan=False)


def through_json(record):
    return from_json(type(record), json.loads(json.dumps(to_json(record), allow_nan=False)))


@given(
    st.builds(
        Candidate,
        setting=st.dictionaries(TEXTS, TEXTS | st.integers() | st.none(), max_size=3),
        fit=st.sampled_from(Fit),
        measured=st.booleans(),
        value_ns=FLOATS,
        metric=TEXTS,
        latency_ns=FLOATS,
        lower_ns=FLOATS,
        upper_ns=FLOATS,
        margin_ns=FLOATS,
        messages=st.integers(),
        held_out=st.integers(),
        tied=st.booleans(),
        reason=TEXTS,
    )
)
def test_a_record_comes_back_equal(candidate):
    recommendation = Recommendation(JOB, (candidate,))
    assert through_json(recommendation) == recommendation


def test_not_a_number_comes_back():
    assert math.isnan(through_json(Job("binary", 1, math.nan, 1, 0.5)).rate_hz)


def test_a_whole_number_in_the_place_of_a_float_stays_whole():
    assert repr(through_json(Job("binary", 1, 10, 1, 0.5)).rate_hz) == "10"


FINDING = Finding(Severity.INFO, "code", "where", "what", "action", (1, 2))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"severity": "bad"}, "Finding.severity: 'bad' is not a valid Severity"),
        ({"code": 5}, "Finding.code is 5"),
        ({"groups": [1, "2"]}, "Finding.groups is '2'"),
        ({"groups": 1}, "Finding.groups is 1"),
        ({"count": True}, "Finding.count is True"),
    ],
)
def test_another_type_is_refused(change, words):
    assert from_json(Finding, to_json(FINDING)) == FINDING
    with pytest.raises(ValueError, match=words):
        from_json(Finding, {**to_json(FINDING), **change})


def test_a_missing_field_is_refused():
    with pytest.raises(ValueError, match="Finding lacks severity"):
        from_json(Finding, {})
    with pytest.raises(ValueError, match="Finding is None"):
        from_json(Finding, None)
