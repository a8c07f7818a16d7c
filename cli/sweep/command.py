"""`dds-sweep`: record all runs of a plan, unattended."""

from __future__ import annotations

import json
import math
import signal
import sys
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.streams import plain_console
from dds_trace.base.units import counted

from ..program import run_program
from ..quick_help import Version, argument, command_app, declare_command, option
from . import new

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from dds_trace.analyzer.verdicts.gate import Gate
    from dds_trace.recorder.sweep.plan.plan import Plan
    from dds_trace.recorder.sweep.sweep import Until

INTERRUPTED_EXIT_CODE = 130
"""Exit code after Ctrl-C, as shells report it."""

app = command_app(completes=True)


class Printed(str, Enum):
    RELAY = "relay"


@declare_command(app, "sweep")
def main_command(
    plan: Annotated[Path, argument("PLAN", "TOML file, e.g. plans/quick.toml.")],
    out: Annotated[
        Path, option("--out FOLDER", "Folder for the traces, in OUT/NAME with the name of the plan.", show_default=True)
    ] = Path("runs"),
    dry_run: Annotated[
        bool,
        option(
            "--dry-run", "Show the recordings and how long they take, and check their options; run nothing of the plan."
        ),
    ] = False,
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
    max_rate: Annotated[
        bool, option("--max-rate", "Search the highest rate that works, instead of the plan's rates.")
    ] = False,
    limits_file: Annotated[
        Path | None, option("--limits FILE", "A limits.toml, whose limits of one side the results have to meet.")
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
    explain_rates: Annotated[
        bool,
        option(
            "--explain-rates",
            "Explain why the plan's slowest rate takes longer than its fastest: in shares that add up.",
        ),
    ] = False,
    explain_size: Annotated[
        str | None,
        option(
            "--explain-size SIZE",
            "Explain a jump of the latency around a size, such as 502KB, or between two: 400KB..700KB. Varies buffer, segment, "
            "fragment, history and a link's queue one at a time.",
        ),
    ] = None,
    advises: Annotated[
        bool,
        option(
            "--advise",
            "Look for settings of each middleware that serve the plan's link and load better than its defaults; print the file and the proof.",
        ),
    ] = False,
    as_json: Annotated[bool, option("--json", "Print the result as JSON.")] = False,
    version: Version = False,  # noqa: ARG001 - its callback does it
) -> None:
    """Record every run of a plan: one closed trace for each device and run.

    If it is interrupted, the same command continues with what is missing. Exit codes: 0 everything is complete; 10 some
    recordings are not (the reasons are on stderr and in state.json); 11 some results are less precise than --until.

    Write a commented plan from three questions:

        dds-sweep new mine.toml
    """
    from dds_trace.recorder.backends import installed_middlewares
    from dds_trace.recorder.sweep.plan.flows import is_crowded
    from dds_trace.recorder.sweep.plan.plan_file import read_plan

    from .advise import advise
    from .against import new_side, run_sides
    from .dry_run import dry_run as dry_run_of
    from .explain import made_explanation, run_explanation
    from .thresholds import precision, read_thresholds

    _refuse_together(
        {
            "--max-rate": max_rate,
            "--until": until,
            "--against": against,
            "--print": printed,
            "--explain-rates": explain_rates,
            "--explain-size": explain_size,
            "--advise": advises,
        },
        {"--max-passes": max_passes, "--until": until},
    )
    limits.check(limits.FOLDER, str(out), "--out")
    limits.check(limits.REPEATS, max_passes, "--max-passes")
    requested = read_plan(plan, installed_middlewares, by_hand=printed is not None)
    explained = made_explanation(requested, explain_size) if explain_rates or explain_size else None
    requested = explained.plan if explained else requested
    target = None if until is None else precision(until, max_passes, requested)
    other = None if against is None else new_side(against, plan, requested, installed_middlewares)
    if (requested.flows or any(map(is_crowded, requested.cells))) and (max_rate or against is not None):
        raise OptionError(
            "[[flows]], relays, hosts, pings and topics are swept as they are; remove --max-rate or --against"
        )
    gates = read_thresholds(requested, target, limits_file, is_judged=not (max_rate or against or advises))
    if dry_run or rehearse:
        code = dry_run_of(requested, out, other, target, max_rate=max_rate, as_json=as_json, rehearses=rehearse)
        raise typer.Exit(code)
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, signal.default_int_handler)
    try:
        if advises:
            code = advise(requested, out, as_json=as_json)
        elif max_rate:
            code = _search(requested, out, as_json)
        elif explained is not None:
            code = run_explanation(explained, out, as_json=as_json)
        elif other is not None:
            code = run_sides(requested, other, out, as_json=as_json)
        else:
            code = _sweep(requested, out, as_json, target, gates)
    except KeyboardInterrupt:
        print("Interrupted; the same command continues here", file=sys.stderr)
        code = INTERRUPTED_EXIT_CODE
    raise typer.Exit(code)


def _refuse_together(kinds: dict[str, object], dependent: dict[str, object]) -> None:
    chosen = [name for name, value in kinds.items() if value]
    if len(chosen) > 1:
        reason = (
            "they start the programs of both devices and cannot wait for a person"
            if "--print" in chosen
            else "each is another kind of sweep"
        )
        raise OptionError(f"{' and '.join(chosen)} cannot be combined: {reason}; remove one")
    (option, value), (needed, other) = dependent.items()
    if value is not None and other is None:
        raise OptionError(f"{option} needs {needed}; give both or remove it")


def _sweep(plan: Plan, out: Path, as_json: bool, until: Until | None, gates: Sequence[Gate]) -> int:
    from dds_trace.recorder.sweep.run.progress import make_progress
    from dds_trace.recorder.sweep.sweep import INCOMPLETE_EXIT_CODE, TOO_WIDE_EXIT_CODE, run_sweep

    from .against import say_missing
    from .dry_run import relay_commands
    from .thresholds import exit_code_of, judge, shown

    console = plain_console(stderr=True)
    progress = make_progress(console)
    if plan.by_hand:
        for line in relay_commands(plan):
            progress.note(line)
    outcome = run_sweep(plan, out, progress, until=until)
    complete = outcome.cells - len(outcome.missing)
    judged = judge(outcome.folder, gates) if gates and complete else []
    if as_json:
        result = {"folder": str(outcome.folder), "cells": outcome.cells, "missing": outcome.missing}
        if until is not None:  # JSON has no infinity
            result["too_wide"] = {
                name: width if math.isfinite(width) else None for name, width in outcome.too_wide.items()
            }
        if gates:
            result["thresholds"] = [judgement.to_json() for judgement in judged]
        print(json.dumps(result))
    else:
        print(f"Wrote {outcome.folder}")
        print(f"{complete} of {counted(outcome.cells, 'recording is', 'recordings are')} complete")
        print("".join(f"{line}\n" for line in shown(judged)), end="")
    say_missing(outcome.missing)
    for name, width in outcome.too_wide.items():
        assert until is not None
        precision = f"known to +-{width:.1f} %" if math.isfinite(width) else "without a two-sided interval"
        print(f"{name}: {until.statistic} is {precision} after the last repeat", file=sys.stderr)
    if outcome.missing:
        return INCOMPLETE_EXIT_CODE
    return exit_code_of(judged) or (TOO_WIDE_EXIT_CODE if outcome.too_wide else 0)


def _search(plan: Plan, out: Path, as_json: bool) -> int:
    from rich.table import Table

    from dds_trace.recorder.sweep.max_rate_report import COLUMNS, max_rate_rows, write_max_rates
    from dds_trace.recorder.sweep.run.progress import make_progress
    from dds_trace.recorder.sweep.search import RateAnswer
    from dds_trace.recorder.sweep.sweep import INCOMPLETE_EXIT_CODE, run_search

    folder, answers = run_search(plan, out, make_progress(plain_console(stderr=True)))
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


COMMANDS: Mapping[str, typer.Typer] = {"new": new.app}
"""Name -> command; a plan of that name is written `./new`."""


def main(
    arguments: Sequence[str] | None = None, *, name: str = "dds-sweep", adapt: Callable[[Any], object] | None = None
) -> None:
    run_program(name, app, COMMANDS, arguments, adapt=adapt)


if __name__ == "__main__":
    main()
