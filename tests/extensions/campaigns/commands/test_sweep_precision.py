import json
from pathlib import Path

import pytest
from processes import run, socket_plan
from warm_start import stand_ins

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.campaigns.commands.against import _in_words
from dds_trace.extensions.campaigns.verdicts.false_alarms import FalseAlarms, half_widths
from dds_trace.tracefile.reading.reader import read_trace

CELL = "socket_same_binary-1KB_200Hz"


@pytest.fixture
def plan(tmp_path, domain_id):
    def write(repeats, messages=60):
        path = tmp_path / "p.toml"
        path.write_text(socket_plan(domain_id, messages=messages, repeats=repeats))
        return path

    return write


def sweep(*arguments):
    return run("dds-trace", "sweep", *arguments)


def passes_in(folder):
    return sorted(int(read_trace(path).runs[0].labels["pass"]) for path in folder.glob("*.ping.mcap"))


def width_of(folder, statistic):
    run_ids = [read_trace(path).runs[0].run_id for path in folder.glob("*.ping.mcap")]
    rows = analyze(folder, details=False).load_messages()
    return half_widths(rows, {CELL: run_ids}, statistic)[CELL]


@pytest.mark.middleware
def test_until_adds_passes_and_says_which_cells_are_still_too_wide(plan, tmp_path):
    # Two passes give no interval between runs, and no sixth run is exact to a millionth.
    options = (plan(2), "--out", tmp_path / "runs", "--until", "rtt_p50:0.000001%", "--max-passes", 6, "--json")
    done = sweep(*options)
    assert done.status == 11, done.stderr
    result = json.loads(done.stdout)
    assert (result["cells"], result["missing"], list(result["too_wide"])) == (6, {}, [CELL])
    assert f"{CELL}: rtt_p50 is known to +-" in done.stderr
    assert passes_in(tmp_path / "runs/p") == [1, 2, 3, 4, 5, 6]
    # These six runs are precise enough for twice the width that they have, and nothing is recorded again. How wide
    # that is, is the machine's: a relay that starved for one of the runs has given more than 10,000 %.
    enough = 2 * width_of(tmp_path / "runs/p", "rtt_p50")
    again = sweep(plan(2), "--out", tmp_path / "runs", "--until", f"rtt_p50:{enough:.3f}%", "--json")
    assert again.status == 0, again.stderr
    assert json.loads(again.stdout)["too_wide"] == {}
    assert passes_in(tmp_path / "runs/p") == [1, 2, 3, 4, 5, 6]


@pytest.mark.middleware
def test_until_a_tail_is_known_to_five_percent_or_the_passes_are_used_up(plan, tmp_path):
    """How many passes that takes is the machine's; that the sweep ends for one of the two reasons, and says which, is not."""
    three = plan(3, messages=110)  # a p99 takes 100
    options = ("--out", tmp_path / "runs", "--until", "latency_p99:5%", "--max-passes", 4, "--json")
    done = sweep(three, *options)
    result = json.loads(done.stdout)
    folder = tmp_path / "runs/p"
    passes, width = passes_in(folder), width_of(folder, "latency_p99")
    assert passes in ([1, 2, 3], [1, 2, 3, 4])
    assert (done.status, list(result["too_wide"])) == ((0, []) if width <= 5 else (11, [CELL]))
    if len(passes) == 3:
        assert width <= 5
    if width > 5:
        assert len(passes) == 4


@pytest.mark.thorough
@pytest.mark.middleware
def test_a_against_a_prints_how_often_the_comparison_errs_and_leaves_two_folders_to_compare(plan, tmp_path):
    done = sweep(plan(3), "--out", tmp_path / "runs", "--against", "SAME", "--json")
    assert done.status == 0, done.stderr
    result = json.loads(done.stdout)
    passes = passes_in(Path(result["base"]))
    assert passes == passes_in(Path(result["new"]))
    assert passes in ([1, 2, 3], [1, 2, 3, 4])  # the fourth again for one that met a busier machine
    assert (result["cells"], result["missing"]) == (2 * len(passes), {"base": {}, "new": {}})
    alarms = result["false_alarms"]
    assert alarms["deals"] == 2 ** (len(passes) - 1)  # each pass behind the first exchanged or not
    assert alarms["of_dealt"] == alarms["deals"] * alarms["of_measured"] > 0
    compared = run("dds-trace", "compare", result["base"], result["new"], "--paired", "--report", "md", "--all")
    assert compared.status == 0, compared.stderr


@pytest.mark.middleware
def test_another_python_environment_records_the_new_side(plan, tmp_path):
    """The environment is a folder whose dds-record runs ours with a device name of its own: the base is not run by it."""
    program = tmp_path / "venv/bin/dds-record"
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec "{stand_ins() / "dds-record"}" "$@" --device elsewhere\n')
    program.chmod(0o755)
    done = sweep(plan(1), "--out", tmp_path / "runs", "--against", tmp_path / "venv", "--json")
    assert done.status == 0, done.stderr
    result = json.loads(done.stdout)
    devices = {
        side: {read_trace(path).sessions[0].device for path in Path(result[side]).glob("*.mcap")}
        for side in ("base", "new")
    }
    assert devices["new"] == {"elsewhere"}
    assert "elsewhere" not in devices["base"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--until", "latency_p99"), "write STATISTIC:PERCENT"),
        (("--until", "latency_p99:1000001%"), "above 0% and at most 1000000%"),
        (("--until", "lateness_p99:5%"), "is not a statistic"),
        (("--until", "latency_p99:5%", "--max-passes", 2), "below the 3 repeats of the plan"),
        (("--max-passes", 9), "--max-passes needs --until"),
        (("--until", "latency_p99:5%", "--against", "SAME"), "--until and --against cannot be combined"),
        (("--until", "latency_p99:5%", "--print", "relay"), "cannot wait for a person"),
        (("--against", "nowhere"), "give another plan.toml"),
    ],
)
def test_options_that_make_no_sense_are_refused(plan, tmp_path, options, message):
    done = sweep(plan(3), "--out", tmp_path / "runs", *options)
    assert (done.status, done.stdout) == (2, "")
    assert message in done.stderr
    assert not (tmp_path / "runs").exists()


def test_dry_run_tells_the_most_that_further_passes_take_and_the_turns_of_two_sides(plan, sentences):
    until = sweep(plan(3), "--dry-run", "--until", "latency_p99:5%", "--max-passes", 6)
    turns = sweep(plan(2), "--dry-run", "--against", "SAME").stdout.splitlines()
    assert turns[:4] == [f"base  {CELL}", f"new   {CELL}", f"new   {CELL}_r2", f"base  {CELL}_r2"]
    sentences(*(line.partition(", about ")[0] for line in (until.stdout.splitlines()[-1], turns[4])))


def test_the_false_alarm_rate_is_printed_in_words(sentences):
    alarms = FalseAlarms(measured=1, of_measured=12, dealt=9, of_dealt=192, deals=16)
    sentences(_in_words(alarms))
