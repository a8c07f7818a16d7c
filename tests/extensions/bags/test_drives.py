"""Two bags side by side: what differs is shown, limits of values and changes decide, and the exit codes are those of `compare`."""

import json
from pathlib import Path

import pytest
from card_bags import timer, write
from trace_files import ping_session, write_trace
from typer.testing import CliRunner

from dds_trace import analyze_topics, compare
from dds_trace.extensions.bags.drives import are_drives
from dds_trace.extensions.gates.command import app

BASE = {"/camera": timer(20, 60), "/imu": timer(100, 60), "/tf": timer(50, 60), "/gps": timer(10, 60)}
BASE["/lidar"] = timer(30, 60)
NEW = {"/camera": timer(20, 60, without=[(30, 33)]), "/imu": timer(90, 60), "/odom": timer(5, 60)}
NEW["/gps"] = timer(10, 60)[100:]
NEW["/lidar"] = [*timer(30, 60)[:900], *timer(30, 60)[900::3]]  # a third of the rate from the middle on


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    return [str(write(folder / f"{name}.mcap", topics)) for name, topics in (("base", BASE), ("new", NEW))]


def compared(*words):
    return CliRunner().invoke(app, [*map(str, words)])


def code_of(done):
    return getattr(done.exception, "exit_code", done.exit_code)


def test_both_sides_are_shown_by_topic(drives):
    done = compared(*drives, "--report", "json")
    assert done.exit_code == 0
    topics = {row.pop("topic"): row for row in json.loads(done.stdout)["topics"]}
    assert topics.keys() == BASE.keys() | NEW.keys()
    assert (topics["/tf"]["new"], topics["/odom"]["base"]) == (None, None)
    assert [topics["/camera"][side]["missing"] for side in ("base", "new")] == [0, 60]
    assert [round(topics["/imu"][side]["rate_hz"]) for side in ("base", "new")] == [100, 90]
    shown = compared(*drives, "--report", "md").stdout.replace("&#8594;", "→")
    for words in (
        "Gone on the new side: /tf. New there: /odom. A larger share of messages is missing on /camera.",
        "Another rate: /lidar 30 Hz → 20 Hz (-33.3 %), /imu 100 Hz → 90 Hz (-10 %). Longest silence, also at start or end: /gps 100 ms → 10 s, /camera 50 ms → 3.05 s.",
        "4 topics on both sides, 2 on one",
        "50 Hz → - | 0 → -",
        "100 Hz → 90 Hz | 0",
        "0 → 60 (5 %)",
    ):
        assert words in shown, shown


@pytest.mark.parametrize(
    ("limit", "code"),
    [
        ("rate(/imu) < -5%", 20),
        ("rate(/imu) < -15%", 0),
        ("rate(/imu) < 95 Hz", 20),
        ("missing(/camera) > 1%", 20),
        ("missing(/camera) > +6 points", 0),
        ("missing(/*) > +1 points", 20),
        ("age_p99(/imu) > +10%", 0),
        ("jitter(/odom) > +10%", 0),  # on one side: undecided
        ("rate(/t*) < -10%", 0),  # gone
        ("hole(/camera) > 1s", 20),
        ("hole(/camera) > +10%", 0),  # of a base of 0 there is no ratio
    ],
)
def test_limits_of_values_and_changes_decide(drives, limit, code):
    assert compared(*drives, "--fail-if", limit, "--allow-missing").exit_code == code


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--fail-if", "jitter(/odom) > +10%", "--allow-missing", "--strict"), 21),
        (("--fail-if", "rate(/imu) < -15%"), 20),  # /tf is gone
        (("--fail-if", "rate(/t*) < -10%"), 20),
        (("--fail-if", "rate(/scan) < -10%"), 2),
        (("--fail-if", "rate(/imu) < -5 points"), 2),
        (("--fail-if", "missing(/imu) > +5%"), 2),
        (("--fail-if", "rate < 95 Hz"), 2),
        (("--paired",), 2),
        (("--report", "junit"), 2),
    ],
)
def test_exit_codes_are_those_of_compare(drives, words, code):
    assert code_of(compared(*drives, *words)) == code


def test_of_a_damaged_side_no_limit_passes(tmp_path, drives):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(Path(drives[0]).read_bytes()[:-1000])
    assert compared(drives[0], cut, "--fail-if", "missing(/*) > 1%", "--allow-missing").exit_code == 20
    assert "<code>dds-trace recover</code>" in compared(drives[0], cut, "--report", "html").stdout


def test_without_a_common_topic_there_is_nothing_to_compare(tmp_path, drives):
    assert compared(drives[0], write(tmp_path / "other.mcap", {"/scan": timer(10, 10)})).exit_code == 22


def test_a_side_of_several_recordings_is_refused(tmp_path, drives):
    for name in ("one", "two"):
        write(tmp_path / f"{name}.mcap", {"/imu": timer(10, 10)})
    done = compared(drives[0], tmp_path)
    assert (code_of(done), "2 recordings" in str(done.exception)) == (2, True)
    bag = analyze_topics(drives[0])
    assert all("/lidar" in shown._repr_markdown_() and len(repr(shown)) < 300 for shown in (bag, compare(bag, bag)))


def test_files_are_written_for_each_report(tmp_path, drives):
    files = [tmp_path / kind / f"comparison.{kind}" for kind in ("md", "html")]
    words = [word for file in files for word in ("--report", file.suffix[1:], "--out", file.parent)]
    done = compared(*drives, *words, "--fail-if", "rate(/imu) < -5%")
    assert (code_of(done), "Gone on the new side: /tf." in done.output) == (20, True)
    assert all("/camera" in file.read_text() for file in files)
    assert all(part in files[1].read_text() for part in ('id="theme"', 'class="data cards"'))


def test_traces_are_no_drives(tmp_path, drives):
    trace = tmp_path / "ping.mcap"
    write_trace(trace, ping_session())
    assert [are_drives(*side) for side in ([trace], [tmp_path / "a"], map(Path, drives))] == [False, False, True]
