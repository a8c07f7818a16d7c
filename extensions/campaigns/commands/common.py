"""What the commands with a plan share: its arguments, what its results have to reach, and an end by Ctrl-C."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.files import given_to_caller
from dds_trace.base.streams import say
from dds_trace.cli.program import argument, option

if TYPE_CHECKING:
    from dds_trace.extensions.gates.gate import Gate
    from dds_trace.extensions.gates.words import Gated

    from ..plan.plan import Plan
    from ..sweep import Until

INCOMPLETE_EXIT_CODE = 10
"""Exit code of `dds-trace sweep` if some cells have no complete recording; the `TraceError` tree has 1 to 9."""

INTERRUPTED_EXIT_CODE = 130
"""Exit code after Ctrl-C, as shells report it."""

AGAIN_S = 0.05
"""Time after which a lost interrupt is raised again."""

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
    from dds_trace.recorder.domains import OWN_DOMAIN

    from ..plan.plan_file import read_plan

    limits.check(limits.FOLDER, str(out), "--out")
    plan = read_plan(path, installed_middlewares, by_hand=by_hand)
    if os.environ.get("ROS_DOMAIN_ID", "") == str(plan.run.domain) != str(OWN_DOMAIN):
        say(f"{path}: in domain {plan.run.domain}, of ROS_DOMAIN_ID")
    return plan


def run_until_interrupted(
    run: Callable[[], int], out: Path, *, analyzes: bool = False, next_step: str = "the same command continues here"
) -> NoReturn:
    """Exit with the code of `run`, or by a stop signal, which is raised again where a destructor or a callback lost it."""
    from dds_trace.recorder.host.process import unignored_stop_signals

    def raise_again(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
            again.daemon = True
            again.start()
        else:
            hook(lost)

    if analyzes:
        import_module("polars")  # before hours of recording
    for number in unignored_stop_signals():
        signal.signal(number, signal.default_int_handler)
    hook, sys.unraisablehook = sys.unraisablehook, raise_again
    try:
        with given_to_caller(out):
            code = run()
    except KeyboardInterrupt:
        print(f"Interrupted; {next_step}", file=sys.stderr)
        code = INTERRUPTED_EXIT_CODE
    finally:
        sys.unraisablehook = hook
    raise typer.Exit(code)


def thresholds_json(gates: Sequence[Gated]) -> object:
    from dds_trace.base.records import to_json

    judged = [
        {
            "threshold": result.gate.text,
            "result": result.subject,
            "outcome": {"regressed": "failed"}.get(result.verdict, result.outcome.word),
            "measured": result.value,
            **{name: getattr(result, name) for name in ("low", "high", "reason")},
        }
        for result in (gated.result for gated in gates)
    ]
    return to_json(judged, not_finite=lambda _: None)


def read_thresholds(plan: Plan, until: Until | None, limits_file: Path | None, *, is_judged: bool = True) -> list[Gate]:
    if not plan.thresholds and limits_file is None:
        return []
    from dds_trace.analyzer.statistics.intervals import MIN_RUNS
    from dds_trace.extensions.gates.limits_file import gates_of, limits_of_one_side, read_limits

    gates = gates_of(plan.thresholds, "[thresholds]")
    if limits_of_one_side(gates) != gates:
        raise OptionError("[thresholds]: a plan has one side; write a value such as 20 ms or 99 %, not a change")
    gates += limits_of_one_side(read_limits(limits_file)) if limits_file else []
    if not is_judged:
        raise OptionError("[thresholds] judge a sweep of the plan itself; remove the table")
    if (plan.run.repeats if until is None else until.max_passes) < MIN_RUNS:
        raise OptionError(f"[thresholds] need {MIN_RUNS} runs of each result; give [run] repeats = {MIN_RUNS} or more")
    return gates


def precision(text: str, max_passes: int | None, plan: Plan) -> Until:
    from ..plan.plan_file import check_runs
    from ..sweep import DEFAULT_MAX_PASSES, Until, parse_target
    from ..verdicts.false_alarms import check_statistic

    statistic, percent = parse_target(text)
    check_statistic(statistic)
    most = max(DEFAULT_MAX_PASSES, plan.run.repeats) if max_passes is None else max_passes
    if most < plan.run.repeats:
        raise OptionError(
            f"--max-passes {most} is below the {plan.run.repeats} repeats of the plan; give at least as many"
        )
    check_runs("--max-passes", len(plan.cells), most)

    def measure(folder: Path, runs: Mapping[str, tuple[int, ...]]) -> Mapping[str, float]:
        from dds_trace.analyzer.pipeline import analyze

        from ..verdicts.false_alarms import half_widths

        if not runs:  # nothing was recorded
            return {}
        return half_widths(analyze(folder, details=False).load_messages(), runs, statistic)

    return Until(statistic, percent, most, measure)
