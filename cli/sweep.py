"""`dds-sweep`: record the whole parameter space of a plan, unattended."""

from __future__ import annotations

import json
import signal
import sys
from collections import Counter
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.tracefile import OptionError, __version__
from dds_trace.tracefile.units.counts import counted

from .errors import run_command

if TYPE_CHECKING:
    from dds_trace.recorder.sweep import Cell, Plan

INTERRUPTED_EXIT_CODE = 130
"""Exit code after Ctrl-C, as shells report it."""

LOOPBACK_MBIT_S = 10_000
"""Rate that hardly any machine carries through a middleware in one direction."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")


class Printed(str, Enum):
    """Role whose commands `--print` shows."""

    RELAY = "relay"


def _print_version(asked: bool) -> None:
    if asked:
        print(f"dds-sweep {__version__}")
        raise typer.Exit


@app.command(context_settings={"help_option_names": ["-h", "--help"]})
def main_command(
    plan: Annotated[
        Path, typer.Argument(help="The plan, a TOML file such as plans/quick.toml.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", help="The traces go to OUT/NAME, NAME as the plan has it.")
    ] = Path("runs"),
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the cells and how long they take, record nothing.")
    ] = False,
    printed: Annotated[
        Printed | None,
        typer.Option(
            "--print",
            help="Show the commands to start on the other device instead of starting them, and wait for "
            "each by its echo.",
            show_default=False,
        ),
    ] = None,
    max_rate: Annotated[
        bool,
        typer.Option("--max-rate", help="Find the highest rate that holds instead of the plan's rates."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    version: Annotated[  # noqa: ARG001 - its callback does it
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Record every cell of a plan: one closed trace for each device and cell.

    Interrupted anywhere, the same command goes on with what is not complete. Ends with 0 if everything is
    complete and with 10 if some cells are not; then the reasons are on stderr and in state.json.
    """
    from dds_trace.recorder.sweep import installed_middlewares, read_plan

    asked = read_plan(plan, installed_middlewares, by_hand=printed is not None)
    if max_rate and printed:
        raise OptionError(
            "--max-rate starts its relays itself and cannot wait for a person; leave --print out"
        )
    if dry_run:
        _show(asked, as_json)
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        code = _search(asked, out, as_json) if max_rate else _sweep(asked, out, as_json)
    except KeyboardInterrupt:
        print("Interrupted; the same command goes on from here", file=sys.stderr)
        code = INTERRUPTED_EXIT_CODE
    raise typer.Exit(code)


def _sweep(plan: Plan, out: Path, as_json: bool) -> int:
    from rich.console import Console

    from dds_trace.recorder.sweep import INCOMPLETE_EXIT_CODE, make_progress, run_sweep

    console = Console(stderr=True)
    progress = make_progress(console)
    if plan.by_hand:
        for line in _relay_commands(plan):
            progress.note(line)
    done = run_sweep(plan, out, progress)
    complete = done.cells - len(done.missing)
    if as_json:
        print(json.dumps({"folder": str(done.folder), "cells": done.cells, "missing": done.missing}))
    else:
        print(f"Wrote {done.folder}")
        print(f"{complete} of {counted(done.cells, 'cell is', 'cells are')} complete")
    for name, reason in done.missing.items():
        print(f"{name}: {reason}", file=sys.stderr)
    return INCOMPLETE_EXIT_CODE if done.missing else 0


def _search(plan: Plan, out: Path, as_json: bool) -> int:
    from rich.console import Console
    from rich.table import Table

    from dds_trace.recorder.sweep import (
        COLUMNS,
        INCOMPLETE_EXIT_CODE,
        RateAnswer,
        make_progress,
        max_rate_rows,
        run_search,
        write_max_rates,
    )

    folder, answers = run_search(plan, out, make_progress(Console(stderr=True)))
    written = write_max_rates(folder, answers, plan.search)
    rows = max_rate_rows(answers)
    if as_json:
        print(json.dumps([dict(zip(COLUMNS, row, strict=True)) for row in rows]))
    else:
        table = Table(*COLUMNS, box=None)
        for row in rows:
            table.add_row(*row)
        # A terminal folds what is too long for it; a file is to have whole lines.
        Console(width=None if sys.stdout.isatty() else 200).print(table)
        for path in written:
            print(f"Wrote {path}")
    return INCOMPLETE_EXIT_CODE if any(highest.answer is RateAnswer.FAILED for highest in answers) else 0


def _show(plan: Plan, as_json: bool) -> None:
    """Print the cells in the order in which they run."""
    from dds_trace.recorder.sweep import plan_seconds, schedule

    groups = schedule(plan)
    cells = [cell for group in groups for cell in group.cells]
    if as_json:
        listed = [{"name": cell.name, "seconds": plan.run.planned_seconds(cell.rate)} for cell in cells]
        print(json.dumps({"plan": plan.name, "seconds": plan_seconds(plan).seconds, "cells": listed}))
        return
    for group in groups:
        print(f"relay {group.need.name}" + (f", half of {group.bridge} beside it" if group.bridge else ""))
        for cell in group.cells:
            print(f"  {cell.name}  {plan.run.planned_seconds(cell.rate):.0f} s{_doubt(plan, cell)}")
    for reason, count in Counter(reason for _, reason in plan.excluded).items():
        print(f"left out by [[exclude]]: {counted(count, 'cell')}" + (f" ({reason})" if reason else ""))
    if plan.link is not None:
        print(f"link: {plan.link}")
    if plan.by_hand:
        for line in _relay_commands(plan):
            print(line)
    print(
        f"plan {plan.name}: {counted(len(cells), 'cell')}, {len(plan.excluded)} left out, "
        f"{counted(len(groups), 'start of a relay', 'starts of a relay')}, "
        f"about {plan_seconds(plan)}"
    )


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


def _relay_commands(plan: Plan) -> list[str]:
    """Return the commands for a person to start on the other device, in order."""
    from dds_trace.recorder.sweep import half_arguments, printed_command, relay_arguments, schedule

    lines = []
    for group in schedule(plan):
        lines.append(
            f"relay {group.number}: {printed_command(relay_arguments(plan, group.need), group.number)}"
        )
        if group.bridge:
            lines.append(f"beside it: dds-bridge {' '.join(half_arguments(plan, group))}")
    return lines


def main() -> None:
    """Run `dds-sweep`."""
    run_command(app)


if __name__ == "__main__":
    main()
