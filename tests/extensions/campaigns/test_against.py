import os
from pathlib import Path

import pytest
from sweep_desk import COMMAND, FIRST, PLAN, SECOND, Heard, files_of

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.against import against_seconds, interleave, run_against
from dds_trace.extensions.campaigns.commands.against import NewSide, keep_to_environment
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schedule import OWN_COST_S, RELAY_OVERHEAD_S, RUN_OVERHEAD_S

ONE_CELL = PLAN.replace("[100, 200]", "100").replace("[axes]", "repeats = 4\n[axes]")
OTHER = ONE_CELL.replace("[axes]", '[axes]\nreliability = "best_effort"')


def plan(text=ONE_CELL):
    return parse_plan(text, "p", "p.toml")


def runs_of(base, new):
    return [(run.side, run.group.cells[0].name, run.group.number) for run in interleave(base, new)]


def test_sides_are_interleaved_and_the_first_one_alternates():
    assert runs_of(plan(), plan(OTHER)) == [
        ("base", FIRST, 1),
        ("new", f"{FIRST}_best_effort", 2),
        ("new", f"{FIRST}_best_effort_r2", 3),
        ("base", f"{FIRST}_r2", 4),
        ("base", f"{FIRST}_r3", 5),
        ("new", f"{FIRST}_best_effort_r3", 6),
        ("new", f"{FIRST}_best_effort_r4", 7),
        ("base", f"{FIRST}_r4", 8),
    ]


def test_linear_drift_over_two_alternating_passes_is_the_same_for_both_sides_of_a_cell():
    text = PLAN.replace("[axes]", 'repeats = 2\norder = "alternating"\n[axes]')
    indices = {}
    for index, run in enumerate(interleave(plan(text), plan(text))):
        indices.setdefault((run.side, run.group.cells[0].rate), []).append(index)
    assert [sum(pair) for pair in indices.values()] == [7] * 4  # 0 .. 7 in pairs


def test_sides_of_different_length_are_refused():
    with pytest.raises(OptionError, match="the base has 1 result and the new side 2"):
        interleave(plan(), plan(PLAN))


def test_time_of_both_sides_has_a_start_of_the_relay_for_each_run():
    # 5 messages at 100 Hz, no settling, eight runs
    assert against_seconds(plan(), plan(OTHER)).seconds == pytest.approx(
        8 * (0.05 + RUN_OVERHEAD_S + OWN_COST_S + RELAY_OVERHEAD_S)
    )


def test_two_folders_are_recorded_interleaved_and_again_only_what_is_missing(desk):
    base, new = (plan(text.replace("repeats = 4", "repeats = 2")) for text in (ONE_CELL, OTHER))
    folder = desk.folder / "runs/ab"
    heard = Heard()
    outcome = run_against(base, new, folder, heard, commands=(COMMAND, COMMAND))
    assert (outcome.base.missing, outcome.new.missing) == ({}, {})
    assert sorted(path.name for path in (folder / "base").glob("*.mcap")) == files_of(FIRST, f"{FIRST}_r2")
    assert sorted(path.name for path in (folder / "new").glob("*.mcap")) == files_of(
        f"{FIRST}_best_effort", f"{FIRST}_best_effort_r2"
    )
    written = [
        Path(start["arguments"][start["arguments"].index("--out") + 1])
        for start in desk.starts
        if start["cell"] != "relay"
    ]
    assert [path.parents[1].name for path in written] == ["base", "new", "new", "base"]
    assert [name for name, _, _ in heard.ended_cells][:2] == [f"base {FIRST}", f"new {FIRST}_best_effort"]
    starts = desk.started
    again = Heard()
    run_against(base, new, folder, again, commands=(COMMAND, COMMAND))
    assert desk.started == starts
    assert again.begun == (4, 4)
    busy = [(FIRST, 2), (FIRST, 3)]  # of a repeat that was recorded again it is not asked
    outcome = run_against(base, new, folder, again, commands=(COMMAND, COMMAND), busier=lambda *_: busy)
    assert (outcome.base.cells, outcome.new.cells) == (3, 3)
    assert desk.started - starts == {FIRST: 1, f"{FIRST}_best_effort": 1, "relay": 2}
    assert "busier" in again.notes[-1]
    assert len(list(folder.glob("*/*.ping.mcap"))) == 6, "nothing recorded is lost"


def test_failure_of_one_side_is_that_sides_and_the_other_goes_on(desk):
    desk.script(**{SECOND: ["unavailable"]})
    once = ONE_CELL.replace("repeats = 4", "repeats = 1")
    base, new = plan(once), plan(once.replace("100", "200"))
    outcome = run_against(base, new, desk.folder / "runs/ab", Heard(), commands=(COMMAND, COMMAND))
    assert outcome.base.missing == {}
    assert list(outcome.new.missing) == [SECOND]


def test_environment_is_an_axis_whose_cells_are_run_by_the_dds_record_of_that_folder(desk):
    program = desk.folder / "kilted/bin/dds-record"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\nexec " + " ".join(COMMAND) + ' "$@" --from kilted\n')
    program.chmod(0o755)
    axis = f'[axes]\nenvironment = ["", "{program.parents[1]}"]'
    text = ONE_CELL.replace("repeats = 4", "repeats = 1").replace("[axes]", axis)
    outcome = desk.sweep(text)
    assert outcome.missing == {}
    assert desk.traces == files_of(FIRST, f"{FIRST}_kilted")
    by_folder = {start["cell"] for start in desk.starts if start["arguments"][-2:] == ["--from", "kilted"]}
    assert by_folder == {f"{FIRST}_kilted", "relay"}
    pings = {start["cell"]: start["arguments"] for start in desk.starts}
    assert "environment=kilted" in pings[f"{FIRST}_kilted"]
    assert not any("environment=" in word for word in pings[FIRST])


def test_what_another_environment_recorded_is_no_run_of_this_one(tmp_path):
    """The same command after a change of its code would print the verdict on the code before."""
    for name in ("one", "two"):
        (tmp_path / name / "lib").mkdir(parents=True)
        (tmp_path / name / "lib/node.py").write_text("")
    one, two = (NewSide("new", plan(), environment=tmp_path / name) for name in ("one", "two"))
    keep_to_environment(side := tmp_path / "new", one)
    keep_to_environment(side, two)  # nothing was recorded yet
    (side / "state.json").write_text("{}")
    keep_to_environment(side, two)
    os.utime(tmp_path / "two/lib/node.py", ns=(0, 2 * 10**18))
    for other in (one, two, NewSide("new", plan())):
        with pytest.raises(OptionError, match="another environment"):
            keep_to_environment(side, other)
