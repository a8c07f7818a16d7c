"""Further passes of a sweep until a statistic of every cell is known precisely enough.

What "precisely" means is the caller's: a sweep knows traces, and an analysis knows intervals.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted

from .plan.schedule import number_groups, schedule_pass
from .run.state import Status

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from .plan.cells import Cell
    from .plan.plan import Plan
    from .run.runner import Runner

    RunIds = Mapping[str, tuple[int, ...]]
    """Name of a cell -> ids of its complete runs, in the order of the passes."""

    MeasureWidths = Callable[[Path, RunIds], Mapping[str, float]]
    """Function from the folder of a sweep and the runs of its cells to the half width of each cell's interval."""

DEFAULT_MAX_PASSES = 20
"""Passes at most by default. Runs whose statistic spreads by 10 % (standard deviation) need 18 for an interval of +-5 %."""

_TARGET = re.compile(r"\s*(\w+)\s*:\s*([0-9.]+)\s*%\s*")


@dataclass(frozen=True, slots=True)
class Until:
    """The precision at which a sweep ends.

    Attributes:
        statistic: what is measured, such as `latency_p99`.
        percent: widest half width of its interval, in percent of the value.
        max_passes: most passes, those of the plan included.
        measure: returns the half width of each cell's interval in percent; infinite where the interval lacks an end.
    """

    statistic: str
    percent: float
    max_passes: int
    measure: MeasureWidths


@dataclass(frozen=True, slots=True)
class FurtherPasses:
    """What the passes after those of the plan have given.

    Attributes:
        cells: cells of these passes.
        too_wide: name of each cell that is still too wide -> half width in percent.
    """

    cells: tuple[Cell, ...]
    too_wide: dict[str, float]


def parse_target(text: str) -> tuple[str, float]:
    """Return statistic and percent of a text such as `latency_p99:5%`.

    Raises:
        OptionError: the text is none such.
    """
    match = _TARGET.fullmatch(text)
    try:
        percent = float(match[2]) if match else 0.0
    except ValueError:
        percent = 0.0
    if match is None or limits.WIDTH_PERCENT.fault(percent) is not None:
        raise OptionError(
            f"--until {limits.shown(text)}: write STATISTIC:PERCENT, for example latency_p99:5%, above 0% and at most "
            f"{limits.WIDTH_PERCENT.high:.0f}%"
        )
    return match[1], percent


def run_further_passes(
    plan: Plan, runner: Runner, until: Until, note: Callable[[str], None]
) -> FurtherPasses:
    """Run passes over the cells that are too wide, until there are none or the passes are used up.

    A cell without any complete run is left out: it has failed, and its reason is told.
    """
    cells: list[Cell] = []
    measured: RunIds = {}
    widths: Mapping[str, float] = {}
    groups_before = 0
    number = plan.run.repeats
    while True:
        runs = _complete_runs(plan, runner, until.max_passes)
        if runs != measured:  # an interrupted sweep finds passes that are there already
            measured, widths = runs, until.measure(runner.folder, runs)
        too_wide = {name: widths[name] for name in runs if not widths[name] <= until.percent}
        if not too_wide or number >= until.max_passes:
            return FurtherPasses(tuple(cells), too_wide)
        number += 1
        note(
            f"pass {number}: {until.statistic} of {counted(len(too_wide), 'combination is', 'combinations are')} "
            f"wider than +-{until.percent:g} %"
        )
        of_pass = schedule_pass(plan, [cell for cell in plan.cells if cell.name in too_wide], number)
        groups = number_groups(of_pass, first=groups_before + len(plan.cells) * plan.run.repeats + 1)
        groups_before += len(groups)
        cells += [cell for group in groups for cell in group.cells]
        runner.run(groups)


def _complete_runs(plan: Plan, runner: Runner, passes: int) -> RunIds:
    """Return the complete runs of each cell that has one."""
    runs = {}
    for cell in plan.cells:
        states = [runner.state[replace(cell, repeat=number).name] for number in range(1, passes + 1)]
        run_ids = tuple(int(state.run_id, 16) for state in states if state.status is Status.COMPLETE)
        if run_ids:
            runs[cell.name] = run_ids
    return runs
