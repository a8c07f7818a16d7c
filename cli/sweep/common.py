"""What the commands with a plan share: its arguments, and an end by Ctrl-C."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.base import limits

from ..program import argument, option

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import NoReturn

    from dds_trace.recorder.sweep.plan.plan import Plan

INTERRUPTED_EXIT_CODE = 130
"""Exit code after Ctrl-C, as shells report it."""

PlanPath = Annotated[Path, argument("PLAN", "TOML file, e.g. plans/quick.toml.")]
Out = Annotated[
    Path, option("--out FOLDER", "Folder for the traces, in OUT/NAME with the name of the plan.", show_default=True)
]
DryRun = Annotated[
    bool, option("--dry-run", "Show the recordings, how long they take, and what cannot start here; run nothing.")
]
AsJson = Annotated[bool, option("--json", "Print the result as JSON.")]


def plan_of(path: Path, out: Path, *, by_hand: bool = False) -> Plan:
    from dds_trace.recorder.backends import installed_middlewares
    from dds_trace.recorder.sweep.plan.plan_file import read_plan

    limits.check(limits.FOLDER, str(out), "--out")
    return read_plan(path, installed_middlewares, by_hand=by_hand)


def run_until_interrupted(run: Callable[[], int]) -> NoReturn:
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, signal.default_int_handler)
    try:
        code = run()
    except KeyboardInterrupt:
        print("Interrupted; the same command continues here", file=sys.stderr)
        code = INTERRUPTED_EXIT_CODE
    raise typer.Exit(code)
