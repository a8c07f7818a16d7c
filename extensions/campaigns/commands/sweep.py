"""`dds-trace sweep PLAN` and `dds-trace capacity PLAN`: record all runs of a plan, or search its highest rates, unattended."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.streams import plain_console, say
from dds_trace.cli.program import command, make_app, option
from dds_trace.extensions.gates.command import FailIf, Looks, Strict

from .common import (
    INCOMPLETE_EXIT_CODE,
    AsJson,
    DryRun,
    Out,
    PlanPath,
    plan_of,
    precision,
    read_thresholds,
    run_until_interrupted,
    thresholds_json,
)

if TYPE_CHECKING:
    from dds_trace.extensions.gates.gate import Gate

    from ..plan.plan import Plan
    from ..sweep import Until

app, capacity = make_app(), make_app()


class Printed(str, Enum):
    RELAY = "relay"


@command(
    app,
    "sweep",
    table="sweep",
    often=("out", "dry_run", "rehearse", "limits_file", "until", "against", "fail_if", "looks"),
)
def sweep_command(
    plan: PlanPath,
    out: Out = Path("runs"),
    dry_run: DryRun = False,
    rehearse: Annotated[
        bool,
        option(
            "--rehearse",
            "As --dry-run, and check that each kind of recording can start: runs the plan's programs, here and by ssh.",
        ),
    ] = False,
    printed: Annotated[
        Printed | None,
        option(
            "--print ROLE",
            "relay: print the relay commands for a person to start on the other device, and wait for the echo of each.",
        ),
    ] = None,
    limits_file: Annotated[
        Path | None,
        option(
            "--limits FILE", "A limits.toml that the results have to meet; without --against, its limits of one side."
        ),
    ] = None,
    until: Annotated[
        str | None,
        option(
            "--until STATISTIC:PERCENT",
            "Repeat until every result is this precise: half the confidence interval in percent of the value, e.g. "
            "latency_p99:5%.",
        ),
    ] = None,
    max_passes: Annotated[
        int | None, option("--max-passes N", "Maximum number of repeats for --until. Default: 40", min=1)
    ] = None,
    against: Annotated[
        str | None,
        option(
            "--against SIDE",
            "Alternate between the plan (base) and another side (new): another plan.toml, the folder of a Python "
            "environment with dds-record, or SAME, which measures how often the comparison is wrong.",
        ),
    ] = None,
    fail_if: FailIf = None,
    looks: Looks = 1,
    strict: Strict = False,
    as_json: AsJson = False,
) -> None:
    """Record every run of a plan, a closed trace for each device.

    If it is interrupted, the same command continues with what is missing. Exit codes: 0 everything is complete; 10 some
    recordings are not (the reasons are on stderr and in state.json); 11 some results are less precise than --until.

    Write a commented plan from three questions:

        dds-trace sweep new mine.toml
    """
    from ..plan.plan_file import check_runs
    from .against import new_side, run_sides
    from .dry_run import dry_run as dry_run_of

    _refuse_together({"--until": until, "--against": against, "--print": printed})
    if max_passes is not None and until is None:
        raise OptionError("--max-passes needs --until; give both or remove it")
    limits.check(limits.REPEATS, max_passes, "--max-passes")
    limits.check(limits.LOOKS, looks, "--looks")
    requested = plan_of(plan, out, by_hand=printed is not None)
    target = None if until is None else precision(until, max_passes, requested)
    other = None if against is None else new_side(against, plan, requested)
    if other is None:
        if fail_if or looks > 1 or strict:
            raise OptionError("--fail-if, --looks and --strict judge two sides; add --against")
        gates = read_thresholds(requested, target, limits_file)
    else:
        _refuse_crowded(requested, "--against")
        check_runs("--looks", len(requested.cells), looks * requested.run.repeats)
        gates = []
        if other.plan.thresholds or fail_if or limits_file:
            from dds_trace.extensions.gates.limits_file import gates_of, read_gates  # polars

            gates = [*gates_of(other.plan.thresholds, "[thresholds]"), *read_gates(fail_if or [], limits_file)]
        other = replace(other, looks=looks)
        if looks > 1 and not gates:
            raise OptionError("--looks end where gates decide; add --fail-if, --limits or [thresholds]")
    if dry_run or rehearse:
        raise typer.Exit(dry_run_of(requested, out, other, target, as_json=as_json, rehearses=rehearse))
    if other is not None:
        run_until_interrupted(lambda: run_sides(requested, other, out, gates, as_json=as_json, strict=strict), out)
    run_until_interrupted(lambda: _sweep(requested, out, as_json, target, gates), out)


def _refuse_together(kinds: dict[str, object]) -> None:
    chosen = [name for name, value in kinds.items() if value]
    if len(chosen) > 1:
        reason = (
            "they start the programs of both devices and cannot wait for a person"
            if "--print" in chosen
            else "each is another kind of sweep"
        )
        raise OptionError(f"{' and '.join(chosen)} cannot be combined: {reason}; remove one")


def _refuse_crowded(plan: Plan, what: str) -> None:
    from ..plan.flows import is_crowded

    if plan.flows or any(map(is_crowded, plan.cells)):
        raise OptionError(f"[[flows]], relays, hosts, pings and topics are swept as they are, without {what}")


@command(capacity, "capacity")
def capacity_command(plan: PlanPath, out: Out = Path("runs"), dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Search the highest rate that works for each setup and message.

    The rates of the plan are not used.
    """
    from ..search import search_plan
    from .dry_run import dry_run as dry_run_of

    requested = plan_of(plan, out)
    _refuse_crowded(requested, "a search")
    read_thresholds(requested, None, None, is_judged=False)
    if dry_run:
        raise typer.Exit(dry_run_of(search_plan(requested), out, None, None, as_json=as_json, searches=True))
    run_until_interrupted(lambda: _search(requested, out, as_json), out)


def _sweep(plan: Plan, out: Path, as_json: bool, until: Until | None, gates: Sequence[Gate]) -> int:
    from ..run.progress import make_progress
    from ..sweep import TOO_WIDE_EXIT_CODE, run_sweep
    from .against import print_complete, say_missing
    from .dry_run import relay_commands

    progress = make_progress()
    if plan.by_hand:
        for line in relay_commands(plan):
            progress.note(line)
    outcome = run_sweep(plan, out, progress, until=until)
    complete = outcome.cells - len(outcome.missing)
    judged = None
    if gates and complete:
        from dds_trace.extensions.gates.report import judge_sides

        judged = judge_sides(outcome.folder, None, gates)
    if as_json:
        result = {"folder": str(outcome.folder), "cells": outcome.cells, "missing": outcome.missing}
        if until is not None:  # JSON has no infinity
            result["too_wide"] = {
                name: width if math.isfinite(width) else None for name, width in outcome.too_wide.items()
            }
        if gates:
            result["thresholds"] = thresholds_json(judged.info.gates if judged else ())
        print(json.dumps(result))
    else:
        print_complete(outcome)
        if judged is not None:
            judged.write()
    say_missing(outcome.missing)
    for name, width in outcome.too_wide.items():
        assert until is not None
        width_words = f"known to +-{width:.1f} %" if width < 1000 else "not known within a factor of ten"
        say(f"{name}: {until.statistic} is {width_words} after the last repeat")
    if outcome.missing:
        return INCOMPLETE_EXIT_CODE
    code = 0 if judged is None else judged.outcome.exit_code
    return code or (TOO_WIDE_EXIT_CODE if outcome.too_wide else 0)


def _search(plan: Plan, out: Path, as_json: bool) -> int:
    from rich.table import Table

    from ..max_rate_report import COLUMNS, max_rate_rows, write_max_rates
    from ..run.progress import make_progress
    from ..search import RateAnswer
    from ..sweep import run_search

    folder, answers = run_search(plan, out, make_progress())
    written = write_max_rates(folder, answers, plan.search)
    rows = max_rate_rows(answers)
    if as_json:
        print(json.dumps([dict(zip(COLUMNS, row, strict=True)) for row in rows]))
    else:
        table = Table(*COLUMNS, box=None)
        for row in rows:
            table.add_row(*row)
        # A file gets whole lines.
        plain_console(width=None if sys.stdout.isatty() else 200).print(table)
        for path in written:
            print(f"Wrote {path}")
    return INCOMPLETE_EXIT_CODE if any(highest.answer is RateAnswer.FAILED for highest in answers) else 0
