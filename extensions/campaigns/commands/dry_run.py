"""`--dry-run` and `--rehearse` of a plan: the recordings, their duration, and which of them cannot start."""

from __future__ import annotations

import json
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from dds_trace.base.errors import OptionError
from dds_trace.base.streams import say, wrapped
from dds_trace.base.units import counted
from dds_trace.cli.record.command import role_app
from dds_trace.cli.table_options import settings_as_options
from dds_trace.recorder.choices import Role
from dds_trace.recorder.option_table import OPTIONS
from dds_trace.recorder.recording import check_options

from .. import rehearsal
from ..plan.cells import Cell
from ..plan.commands import half_arguments, relay_arguments
from ..plan.plan import Plan, depth_warnings
from ..plan.schedule import Remaining, group_by_relay, plan_seconds, schedule
from ..search import search_estimates
from ..station.devices import printed_command
from ..sweep import Until
from .against import NewSide, say_missing, shown_sides, side_folders, startable, startable_words
from .common import INCOMPLETE_EXIT_CODE

LOOPBACK_MBIT_S = 10_000
"""Rate that few machines reach through a middleware in one direction."""


MOST_CHECKED = 20_000
"""Recordings of a dry run, a millisecond each."""


def dry_run(
    plan: Plan,
    out: Path,
    other: NewSide | None,
    until: Until | None,
    *,
    as_json: bool,
    rehearses: bool = False,
    searches: bool = False,
) -> int:
    runs = len(plan.cells) * plan.run.repeats
    if runs > MOST_CHECKED and not rehearses:
        raise OptionError(
            f"--dry-run checks each of at most {MOST_CHECKED:,} recordings, {plan.name} has {runs:,}; give axes fewer values"
        )
    sides = [(plan, out / plan.name, None)] if other is None else side_folders(plan, other, out)
    refused: dict[str, str] = {}
    for side, folder, command in sides:
        if rehearses:
            refused |= rehearsal.rehearse_plan(side, folder, argument_check(), note=say, command=command)
        else:
            refused |= rehearsal.check_plan(side, folder, argument_check())
    if other is not None:
        described, lines = shown_sides(plan, other, refused)
    else:
        described, lines = _shown_search(plan, refused) if searches else _shown(plan, until, refused)
    if rehearses and not refused:
        lines.append("rehearsed: all of them can start")
    print(json.dumps({**described, "cannot_start": refused}) if as_json else wrapped("\n".join(lines), sys.stdout))
    say_missing(refused, what=" cannot start")
    return INCOMPLETE_EXIT_CODE if refused else 0


def argument_check() -> Callable[[Sequence[str]], None]:
    """Return a check that declares options as they are named: all take twice as long."""
    flags = {row.name: name for name, row in OPTIONS.items()}
    fields: set[str] = set()
    commands: dict[tuple[Role, int], Any] = {}

    def check(arguments: Sequence[str]) -> None:
        role = Role(arguments[1])
        options = settings_as_options(arguments[2:], role)
        fields.update(flags[word] for word in (option.partition("=")[0] for option in options) if word in flags)
        command = commands.get((role, len(fields)))
        if command is None:
            command = commands[role, len(fields)] = typer.main.get_command(role_app(role, fields))
        try:
            command.main(options, f"dds-trace record {role}", standalone_mode=False, obj=check_options)
        except Exception as err:  # the name of typer's errors differs between versions
            message = getattr(err, "format_message", None)
            if message is None:
                raise
            raise OptionError(str(message())) from err

    return check


def _shown(plan: Plan, until: Until | None, refused: Mapping[str, str]) -> tuple[dict[str, object], list[str]]:
    groups = schedule(plan)
    cells = [cell for group in groups for cell in group.cells]
    plan_here = startable(plan, refused)
    seconds = plan_seconds(plan_here)
    described: dict[str, object] = {
        "plan": plan.name,
        "seconds": seconds.seconds,
        "cells": [{"name": cell.name, "seconds": plan.run.planned_seconds(cell.rate, cell.outage)} for cell in cells],
    }
    lines = []
    for group in groups:
        lines.append(
            f"relay {group.need.relay_name}" + (f", half of {group.bridge} next to it" if group.bridge else "")
        )
        lines += [
            f"  {cell.name}  {plan.run.planned_seconds(cell.rate, cell.outage):.0f} s{_doubt(plan, cell)}"
            for cell in group.cells
        ]
    lines += _remarks(plan)
    lines.append(
        f"plan {plan.name}: {counted(len(cells), 'recording')}, {_left_out(plan, refused)} left out, "
        f"{counted(len(groups), 'start of a relay', 'starts of a relay')}, about {seconds}{startable_words(cells, refused)}"
    )
    if until is not None:
        most = plan_seconds(plan_here, passes=until.max_passes)
        described["most_seconds"] = most.seconds
        lines.append(
            f"until {until.statistic} of every result is known to +-{until.percent:g} %: at most {until.max_passes} "
            f"repeats, about {most} for all of them"
        )
    return described, lines


def _shown_search(plan: Plan, refused: Mapping[str, str]) -> tuple[dict[str, object], list[str]]:
    plan_here = startable(plan, refused)
    least, expected, most = search_estimates(plan_here)
    described = {
        "plan": plan.name,
        "seconds": expected.seconds,
        "least_seconds": least.seconds,
        "most_seconds": most.seconds,
        "recordings": {"least": least.recordings, "expected": expected.recordings, "most": most.recordings},
        "cells": [{"name": cell.name} for cell in plan.cells],
    }
    starts = counted(len(group_by_relay(plan_here, plan_here.cells)), "start of a relay", "starts of a relay")
    ends = f"{Remaining(least.seconds)} to {Remaining(most.seconds)}, by the rates that work"
    times = f"about {Remaining(expected.seconds)} ({ends})"
    lines = [
        *(f"{cell.name}  from {plan.search.min_rate:g} to {plan.search.max_rate:g} Hz" for cell in plan.cells),
        *_remarks(plan),
        f"plan {plan.name}: {least.recordings} to {counted(most.recordings, 'recording')}, {_left_out(plan, refused)} left out, {starts}, {times}",
    ]
    return described, lines


def _left_out(plan: Plan, refused: Mapping[str, str]) -> int:
    return len(plan.excluded) + len(refused)


def _remarks(plan: Plan) -> list[str]:
    left_out = Counter(reason for _, reason in plan.excluded).items()
    return [
        *(
            f"left out by [[exclude]]: {counted(count, 'result')}" + (f" ({reason})" if reason else "")
            for reason, count in left_out
        ),
        *(f"warning: {warning}" for warning in depth_warnings(plan)),
        *(f"link: {link}" for link in dict.fromkeys(map(plan.link_of, plan.cells)) if link is not None),
        *(relay_commands(plan) if plan.by_hand else []),
    ]


def _doubt(plan: Plan, cell: Cell) -> str:
    link = plan.link_of(cell)
    limit_mbit_s = (link.rate_mbit_s if link else 0) or LOOPBACK_MBIT_S
    payload_mbit_s = (cell.payload_bit_s or 0) / 1e6
    if payload_mbit_s <= limit_mbit_s:
        return ""
    return (
        f"  needs {payload_mbit_s:.0f} of {limit_mbit_s:g} Mbit/s: will be cut off after "
        f"{plan.run.cutoff_seconds:g} s more"
    )


def relay_commands(plan: Plan) -> list[str]:
    lines = []
    for group in schedule(plan):
        lines.append(
            f"relay {group.number}: {printed_command(relay_arguments(plan, group.need, group.cells[0].repeat), group.number)}"
        )
        if group.bridge:
            lines.append(f"next to it: dds-trace bridge {shlex.join(half_arguments(plan, group))}")
    return lines
