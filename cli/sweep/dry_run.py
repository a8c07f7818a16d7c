"""`dds-sweep --dry-run`: the cells, how long they take, and a rehearsal that proves that each kind of them can start."""

from __future__ import annotations

import json
import sys
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

import typer

from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted

from .against import shown_sides, side_folders

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from dds_trace.recorder.sweep.plan.cells import Cell
    from dds_trace.recorder.sweep.plan.plan import Plan
    from dds_trace.recorder.sweep.sweep import Until

    from .against import NewSide

LOOPBACK_MBIT_S = 10_000
"""Rate that hardly any machine carries through a middleware in one direction."""


def dry_run(
    plan: Plan, out: Path, other: NewSide | None, until: Until | None, *, max_rate: bool, as_json: bool
) -> int:
    """Show a sweep and rehearse it; return the exit code that it would end with if nothing around it fails.

    Args:
        plan: the plan.
        out: folder of all sweeps.
        other: the other side of a sweep in turns.
        until: precision at which the sweep ends.
        max_rate: whether the highest rate of each cell is to be searched.
        as_json: whether the result is printed as JSON.
    """
    from dds_trace.recorder.sweep.rehearsal import rehearse_plan
    from dds_trace.recorder.sweep.search import search_plan
    from dds_trace.recorder.sweep.sweep import INCOMPLETE_EXIT_CODE

    described, lines = shown_sides(plan, other) if other is not None else _shown(plan, until)
    if not as_json:
        print("\n".join(lines))
    if other is not None:
        sides = side_folders(plan, other, out)
    else:
        asked = search_plan(plan) if max_rate else plan
        sides = [(asked, out / asked.name, None)]
    refused: dict[str, str] = {}
    for side, folder, command in sides:
        refused |= rehearse_plan(side, folder, check_arguments, note=_note, command=command)
    if as_json:
        print(json.dumps({**described, "cannot_start": refused}))
    _tell(refused)
    return INCOMPLETE_EXIT_CODE if refused else 0


def check_arguments(arguments: Sequence[str]) -> None:
    """Refuse what `dds-record` would refuse of its arguments before it opens anything.

    Raises:
        OptionError: naming the option.
        TraceError: as `check_options`.
    """
    from dds_trace.recorder.rehearsal import check_options

    from ..record.command import app

    command: Any = typer.main.get_command(app)
    command.table = ""  # a plan says all that is measured: no file of defaults adds to it
    try:
        command.main(list(arguments), "dds-record", standalone_mode=False, obj=check_options)
    except Exception as err:  # typer's own errors have no name that all its versions know
        said = getattr(err, "format_message", None)
        if said is None:
            raise
        raise OptionError(str(said())) from err


def _tell(refused: Mapping[str, str]) -> None:
    """Print each reason once, with the cells that it keeps from starting."""
    names = defaultdict(list)
    for name, reason in refused.items():
        names[reason].append(name)
    for reason, cells in names.items():
        more = f" and {counted(len(cells) - 1, 'more recording')}" if len(cells) > 1 else ""
        print(f"{cells[0]}{more} cannot start: {reason}", file=sys.stderr)


def _note(text: str) -> None:
    print(text, file=sys.stderr)


def _shown(plan: Plan, until: Until | None) -> tuple[dict[str, object], list[str]]:
    """Return the cells in the order in which they run, as a JSON object and as lines."""
    from dds_trace.recorder.sweep.plan.schedule import plan_seconds, schedule

    groups = schedule(plan)
    cells = [cell for group in groups for cell in group.cells]
    seconds = plan_seconds(plan)
    described: dict[str, object] = {
        "plan": plan.name,
        "seconds": seconds.seconds,
        "cells": [{"name": cell.name, "seconds": plan.run.planned_seconds(cell.rate)} for cell in cells],
    }
    lines = []
    for group in groups:
        lines.append(
            f"relay {group.need.relay_name}" + (f", half of {group.bridge} beside it" if group.bridge else "")
        )
        lines += [
            f"  {cell.name}  {plan.run.planned_seconds(cell.rate):.0f} s{_doubt(plan, cell)}"
            for cell in group.cells
        ]
    lines += _remarks(plan)
    lines.append(
        f"plan {plan.name}: {counted(len(cells), 'recording')}, {len(plan.excluded)} left out, "
        f"{counted(len(groups), 'start of a relay', 'starts of a relay')}, about {seconds}"
    )
    if until is not None:
        most = plan_seconds(plan, passes=until.max_passes)
        described["most_seconds"] = most.seconds
        lines.append(
            f"until {until.statistic} is known to +-{until.percent:g} % for every combination: {until.max_passes} passes at "
            f"most, about {most} if each takes all of them"
        )
    return described, lines


def _remarks(plan: Plan) -> list[str]:
    """Return the lines about the plan as a whole: what it leaves out, warnings, its link, commands for the other device."""
    from dds_trace.recorder.sweep.plan.plan import depth_warnings

    left_out = Counter(reason for _, reason in plan.excluded).items()
    return [
        *(
            f"left out by [[exclude]]: {counted(count, 'combination')}" + (f" ({reason})" if reason else "")
            for reason, count in left_out
        ),
        *(f"warning: {warning}" for warning in depth_warnings(plan)),
        *([f"link: {plan.link}"] if plan.link is not None else []),
        *(relay_commands(plan) if plan.by_hand else []),
    ]


def _doubt(plan: Plan, cell: Cell) -> str:
    """Return the end of a cell's line if its rate cannot be carried, else an empty text."""
    limit_mbit_s = (plan.link.rate_mbit_s if plan.link else 0) or LOOPBACK_MBIT_S
    asked_mbit_s = (cell.payload_bit_s or 0) / 1e6
    if asked_mbit_s <= limit_mbit_s:
        return ""
    return (
        f"  asks {asked_mbit_s:.0f} of {limit_mbit_s:g} Mbit/s: will be cut off after "
        f"{plan.run.cutoff_seconds:g} s more"
    )


def relay_commands(plan: Plan) -> list[str]:
    """Return the commands for a person to start on the other device, in order."""
    from dds_trace.recorder.sweep.plan.commands import half_arguments, relay_arguments
    from dds_trace.recorder.sweep.plan.schedule import schedule
    from dds_trace.recorder.sweep.station.devices import printed_command

    lines = []
    for group in schedule(plan):
        lines.append(
            f"relay {group.number}: {printed_command(relay_arguments(plan, group.need, group.cells[0].repeat), group.number)}"
        )
        if group.bridge:
            lines.append(f"beside it: dds-bridge {' '.join(half_arguments(plan, group))}")
    return lines
