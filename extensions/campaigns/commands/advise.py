"""`dds-trace advise`: a configuration of each vendor for a plan's link and load, with the proof that it pays."""

from __future__ import annotations

import itertools
import json
import math
import shlex
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import typer

from dds_trace.base.errors import OptionError
from dds_trace.base.streams import say
from dds_trace.cli.program import command, make_app

from .against import say_missing
from .common import AsJson, DryRun, Out, PlanPath, plan_of, read_thresholds, run_until_interrupted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..plan.cells import Cell
    from ..plan.plan import Plan

Advice: TypeAlias = "dict[str, Any]"
"""An entry of the JSON output: `vendor`, `kept`, `reason`, and where there are some `first_look` (bundle -> response against the
default's), `folders`, `proof` and `received` (rows of the comparison, ns), `configuration` and the `variables` that load it."""

LOOKS, PROOFS = 2, 5
"""Repeats in the first look, and fewest ones of the proof."""

WORTH = 0.97
"""Response in a first look, against the default's, that is worth a proof."""

COMPARED: dict[str, Any] = {"metrics": ("response",), "statistics": ("p50", "p90", "p99"), "paired": True}
"""The response counts a message that waits for its turn to be sent, too."""

_MESSAGE = ("data_type", "payload_bytes", "rate_hz")
_PROOF = (*_MESSAGE, "statistic", "base_ns", "new_ns", "ratio", "ratio_low", "ratio_high", "verdict")
_RECEIVED = (*_MESSAGE, "base_received_ratio", "new_received_ratio", "difference_high", "verdict")
_INCOMPLETE = "not everything was recorded"


app = make_app()


@command(app, "advise")
def advise_command(plan: PlanPath, out: Out = Path("runs"), dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Look for settings better than a middleware's defaults.

    For the plan's link and messages; prints file and proof.
    """
    requested = plan_of(plan, out)
    check_advisable(requested)
    read_thresholds(requested, None, None, is_judged=False)
    if dry_run:
        raise typer.Exit(_dry_run(requested, out, as_json=as_json))
    run_until_interrupted(lambda: advise(requested, out, as_json=as_json), out, analyzes=True)


def _dry_run(plan: Plan, out: Path, *, as_json: bool) -> int:
    from .dry_run import dry_run

    cells: list[Cell] = []
    for vendor, (vendor_cells, texts, reason) in _bundles_by_vendor(plan).items():
        if reason:
            say(f"{vendor} is not recorded: {reason}")
        else:  # looks, and both sides of the proof
            cells += vendor_cells * (1 + len(texts) + 2 * _proofs(plan) // LOOKS)
    recorded = replace(plan, cells=tuple(cells), run=replace(plan.run, repeats=LOOKS))
    return dry_run(recorded, out, None, None, as_json=as_json)


def _proofs(plan: Plan) -> int:
    return max(PROOFS, plan.run.repeats)


def _bundles_by_vendor(plan: Plan) -> dict[str, tuple[list[Cell], dict[str, str], str]]:
    """Return cells, bundles by name, and why none is recorded."""
    from dds_trace.recorder.backends.ros2 import vendor_of

    from ..advice import bundles

    cells_of: dict[str, list[Cell]] = defaultdict(list)
    for cell in plan.cells:
        cells_of[vendor_of(cell.rmw) if cell.backend == "ros2" else cell.backend].append(cell)
    by_vendor = {}
    for vendor, cells in cells_of.items():
        texts = bundles(vendor, plan)
        reason = "" if texts else "no settings of it are known here"
        if vendor == "fastdds" and plan.discovery == "localhost":
            reason = "ROS 2's LOCALHOST range adds its own transports; give a [link] or [run] discovery = 'subnet'"
        by_vendor[vendor] = cells, texts, reason
    return by_vendor


def check_advisable(plan: Plan) -> None:
    faults = {
        "another device": plan.has_two_devices,
        "[[flows]]": bool(plan.flows),
        "a bridge": any(cell.crosses_domains for cell in plan.cells),
        "two middlewares in one result": any(cell.relay_backend or cell.relay_rmw for cell in plan.cells),
        "the axes configuration and tuned": any(cell.configuration or cell.tuned for cell in plan.cells),
    }
    for name, is_there in faults.items():
        if is_there:
            raise OptionError(f"advise is not for {name}; remove that from the plan")


def advise(plan: Plan, out: Path, *, as_json: bool) -> int:
    from ..sweep import INCOMPLETE_EXIT_CODE

    check_advisable(plan)
    advices = []
    for vendor, (cells, texts, reason) in _bundles_by_vendor(plan).items():
        folder = out / f"{plan.name}-advice" / vendor
        advice = {"reason": reason} if reason else _advise(replace(plan, cells=tuple(cells)), vendor, texts, folder)
        advices.append({"vendor": vendor, "kept": False, **advice})
    print(json.dumps(advices) if as_json else "\n".join(line for advice in advices for line in shown(advice)))
    return INCOMPLETE_EXIT_CODE if any(advice["reason"].startswith(_INCOMPLETE) for advice in advices) else 0


def _advise(plan: Plan, vendor: str, texts: Mapping[str, str], folder: Path) -> Advice:
    from ..advice import write_bundles
    from ..plan.plan import Order

    paths = write_bundles(vendor, texts, folder / "configurations")
    run = replace(plan.run, order=Order.ALTERNATING)
    looks = _look(replace(plan, run=replace(run, repeats=LOOKS, attempts=1)), paths, folder)
    best = min(paths, key=lambda path: looks.get(path.stem, math.inf))
    if looks.get(best.stem, math.inf) > WORTH:
        reason = "no bundle of settings looked better" if looks else f"{_INCOMPLETE} in the first look"
        return {"reason": reason, "first_look": looks}
    proof = _prove(replace(plan, run=replace(run, repeats=_proofs(plan))), vendor, best, folder / best.stem)
    return {"first_look": looks, **proof}


def _look(plan: Plan, paths: Sequence[Path], folder: Path) -> dict[str, float]:
    from dds_trace.analyzer.pipeline import analyze
    from dds_trace.extensions.gates.costs import first_look

    from ..run.progress import make_progress
    from ..sweep import run_sweep

    tries = {
        replace(cell, configuration=str(path) if path else None): (path.stem if path else "", number)
        for path in (None, *paths)
        for number, cell in enumerate(plan.cells)
    }
    look = replace(plan, name="look", cells=tuple(tries))
    outcome = run_sweep(look, folder, make_progress())
    say_missing(outcome.missing)
    repeats = {
        replace(cell, repeat=number).name: tried for cell, tried in tries.items() for number in range(1, LOOKS + 1)
    }
    failed = {repeats[name][0] for name in outcome.missing}
    analysis = analyze(outcome.folder, details=False)
    tried = {run.run_id: repeats[run.labels["cell"]] for run in analysis.runs}
    means = {name: mean for name, mean in first_look(analysis.load_messages(), tried).items() if name not in failed}
    return {name: mean / means[""] for name, mean in means.items() if name} if "" in means else {}


def _prove(plan: Plan, vendor: str, path: Path, folder: Path) -> Advice:
    from ..advice import variables_of
    from ..against import run_against
    from ..run.progress import make_progress

    new = replace(plan, name="after", cells=tuple(replace(cell, configuration=str(path)) for cell in plan.cells))
    outcome = run_against(replace(plan, name="before"), new, folder, make_progress())
    if missing := {**outcome.base.missing, **outcome.new.missing}:
        return {"reason": f"{_INCOMPLETE} of {path.stem}: {next(iter(missing.values()))}"}
    proof = proof_of(path.stem, outcome.base.folder, outcome.new.folder)
    proof["folders"] = [str(outcome.base.folder), str(outcome.new.folder)]
    if proof["kept"]:
        proof |= {"configuration": str(path.absolute()), "variables": variables_of(vendor, path)}
    return proof


def proof_of(name: str, base: Path, new: Path) -> Advice:
    from dds_trace.analyzer.pipeline import analyze
    from dds_trace.extensions.gates.compare import CompareOptions, compare
    from dds_trace.extensions.gates.costs import pays

    comparison = compare(analyze(base, details=False), analyze(new, details=False), CompareOptions(**COMPARED))
    is_kept = pays(comparison)
    proof = comparison.rows.select(_PROOF).rows(named=True)
    received = comparison.delivery.select(_RECEIVED).rows(named=True)
    reason = f"{name} " + ("is proven better" if is_kept else f"looked best, and {_why_not(proof, received)}")
    return {"kept": is_kept, "reason": reason, "proof": proof, "received": received}


def shown(advice: Advice) -> list[str]:
    looks = sorted(advice.get("first_look", {}).items(), key=lambda look: look[1])
    lines = [
        f"{advice['vendor']}: {'use these settings' if advice['kept'] else 'keep the default'}: {advice['reason']}"
    ]
    lines += [f"  export {name}={shlex.quote(value)}" for name, value in advice.get("variables", {}).items()]
    if looks:
        lines.append(
            f"  first look, times the default's response: {', '.join(f'{name} {ratio:.2f}' for name, ratio in looks)}"
        )
    proof, received = (advice.get(name, ()) for name in ("proof", "received"))
    lost_most = any(row["base_received_ratio"] < 0.5 for row in received)
    parts = [map(_response, proof), map(_delivery, received)]
    for words in itertools.chain(*(reversed(parts) if lost_most else parts)):
        lines.append(f"  {words}")
    if "folders" in advice:
        lines.append(f"  proof: dds-trace compare {shlex.join(advice['folders'])} --paired")
    return lines


def _why_not(proof: Sequence[Advice], received: Sequence[Advice]) -> str:
    from dds_trace.extensions.gates.costs import speaks_against

    fewer, slower = speaks_against(proof, received)
    judged = [*map(_delivery, fewer), *map(_response, slower)]
    if not judged and "better" in {row["verdict"] for row in (*proof, *received)}:
        return "a result is missing, or is not to be judged"
    moved = min((row for row in proof if row["ratio"] is not None), key=lambda row: row["ratio"], default=None)
    most = (
        "" if moved is None or moved["verdict"] != "inconclusive" else f"; moved most, not proven: {_response(moved)}"
    )
    return (judged[0] if judged else "no time and no share received is proven better") + most


def _response(row: Mapping[str, Any]) -> str:
    from dds_trace.reports.book.groups import time_words

    before, after = map(time_words, (row["base_ns"], row["new_ns"]))
    ratios = [row[name] for name in ("ratio", "ratio_low", "ratio_high")]
    is_known = "lost" not in (before, after) and None not in ratios
    times = ", {:.2f} times ({:.2f} to {:.2f})".format(*ratios) if is_known else ""
    return f"{_result(row)}: response {row['statistic']} {before} -> {after}{times}: {row['verdict']}"


def _delivery(row: Mapping[str, Any]) -> str:
    return f"{_result(row)}: received {row['base_received_ratio']:.2%} -> {row['new_received_ratio']:.2%}: {row['verdict']}"


def _result(row: Mapping[str, Any]) -> str:
    return f"{row['data_type']} {row['payload_bytes']:,} bytes at {row['rate_hz']:g} Hz"
