"""`dds-trace explain rates` and `explain size`: record what is varied, and print why the latency rises."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.base.units import format_size
from dds_trace.cli.program import argument, command, make_app

from .common import INCOMPLETE_EXIT_CODE, AsJson, DryRun, Out, PlanPath, plan_of, run_until_interrupted

if TYPE_CHECKING:
    from ..explain import ExplainedSetup, Explanation
    from ..verdicts.explain import Answer, Effect

_WORDS = {
    "awake": "processors kept awake",
    "dma_latency": "/dev/cpu_dma_latency at 0",
    "realtime": "SCHED_FIFO",
    "wake": "a probe just before each message",
}


rates, size = make_app(), make_app()


@command(rates, "rates")
def rates_command(plan: PlanPath, out: Out = Path("runs"), dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Explain why a plan's slowest rate takes longer than its fastest."""
    from ..explain import explain_rates

    _explain(explain_rates(plan_of(plan, out)), out, dry_run=dry_run, as_json=as_json)


@command(size, "size")
def size_command(
    jump: Annotated[str, argument("SIZE", "Where the latency jumps: 502KB, or between two sizes: 400KB..700KB.")],
    plan: PlanPath,
    out: Out = Path("runs"),
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Explain a jump of the latency around a size.

    Varies buffer, segment, fragment, history and queue one at a time.
    """
    from ..explain import explain_size

    _explain(explain_size(plan_of(plan, out), jump), out, dry_run=dry_run, as_json=as_json)


def _explain(explanation: Explanation, out: Path, *, dry_run: bool, as_json: bool) -> None:
    from .dry_run import dry_run as dry_run_of

    if dry_run:
        print(_not_varied(explanation.left_out), end="", file=sys.stderr)
        raise typer.Exit(dry_run_of(explanation.plan, out, None, None, as_json=as_json))
    run_until_interrupted(lambda: run_explanation(explanation, out, as_json=as_json), out, analyzes=True)


def run_explanation(explanation: Explanation, out: Path, *, as_json: bool) -> int:
    from ..run.progress import make_progress
    from ..sweep import run_sweep
    from .against import say_missing

    outcome = run_sweep(explanation.plan, out, make_progress())
    answers, left_out = answer(explanation, outcome.folder) if len(outcome.missing) < outcome.cells else ({}, {})
    left_out = {**explanation.left_out, **left_out}
    if as_json:
        explained = [{"setup": name, **(asdict(item) if item else {})} for name, item in answers.items()]
        result = {"folder": str(outcome.folder), "cells": outcome.cells, "missing": outcome.missing}
        print(json.dumps({**result, "explained": explained, "left_out": left_out}))
    else:
        print(f"Wrote {outcome.folder}")
        for setup in explanation.setups:
            print("\n".join(answer_lines(explanation, setup, answers.get(setup.name))))
        print(_not_varied(left_out), end="")
    say_missing(outcome.missing)
    return INCOMPLETE_EXIT_CODE if outcome.missing else 0


def _not_varied(left_out: Mapping[str, str]) -> str:
    return "".join(f"not varied: {_WORDS.get(name, name)}: {reason}\n" for name, reason in left_out.items())


def answer(explanation: Explanation, folder: Path) -> tuple[dict[str, Answer | None], dict[str, str]]:
    from dds_trace.analyzer.pipeline import analyze

    from ..verdicts.explain import AS_IS, CLIENT, NATIVE, client_median, explain, medians_by_cell, refusals

    analysis = analyze(folder, details=False)
    medians, refused = medians_by_cell(analysis), refusals(analysis)
    varied = {key for setup in explanation.setups for key in setup.pairs}
    answers = {}
    for setup in explanation.setups:
        pairs = {
            key: (base_run.name, other.name) for key, (base_run, other) in setup.pairs.items() if key not in refused
        }
        cells = setup.pairs[AS_IS]
        if explanation.is_of_rates and NATIVE not in pairs and cells[0].backend == "ros2":
            pairs[CLIENT] = f"{cells[0].name} {CLIENT}", f"{cells[1].name} {CLIENT}"
            for cell, name in zip(cells, pairs[CLIENT], strict=True):
                medians[name] = {}
                for number in medians.get(cell.name, {}):
                    traces = folder.glob(f"{replace(cell, repeat=number).name}.*.mcap")
                    wait_ns = client_median(analyze(list(traces)).details.breakdown)
                    medians[name] |= {} if wait_ns is None else {number: wait_ns}
        answers[setup.name] = explain(pairs, medians, is_ratio=not explanation.is_of_rates)
    return answers, {key: reason for key, reason in refused.items() if key in varied}


def answer_lines(explanation: Explanation, setup: ExplainedSetup, result: Answer | None) -> Iterator[str]:
    from ..explain import AS_IS

    before, after = setup.pairs[AS_IS]
    if result is None:
        yield f"{setup.name}: not measured"
    elif explanation.is_of_rates:
        yield f"{setup.name}: from {before.rate:g} Hz to {after.rate:g} Hz the median rises by {_shown(result.rise)}"
        if not result.rise.is_sure:
            yield "  no rise is shown here: record more repeats, or on a quieter machine"
            return
        yield from (f"  {cause.name}: {_shown(cause)}, {cause.share:.0%}" for cause in result.shares)
        yield from (
            f"  with {_WORDS[cause.name]}: less by {_shown(cause)}, {cause.share:.0%}" for cause in result.removed
        )
    else:
        sizes = f"{format_size(after.size or 0)} as at {format_size(before.size or 0)}"
        yield f"{setup.name}: the median takes {_shown(result.rise, is_factor=True)} times as long at {sizes}"
        for cause in result.removed:
            words = set(setup.pairs[cause.name][0].changed_axes) - set(before.changed_axes)
            yield f"  with {' '.join(sorted(words))}: {_shown(cause, is_factor=True)} times less"
        yield f"  what moves it: {result.cause or ('not known' if result.rise.is_sure else 'no jump is shown here')}"


def _shown(effect: Effect, *, is_factor: bool = False) -> str:
    from dds_trace.reports.book.groups import times_words

    values = effect.value, effect.low, effect.high
    value, low, high = [f"{value or 0:.3g}" for value in values] if is_factor else times_words(values)
    return value if effect.low is None or effect.high is None else f"{value} ({low} to {high})"
