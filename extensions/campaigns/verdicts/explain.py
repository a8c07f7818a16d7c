"""Why the latency rises from one cell of a sweep to another: shares that add up, and what removes the rise.

Each number is a weighted sum of the medians of one repeat's runs; its interval is Student's over the repeats.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.runs import pass_numbers
from dds_trace.analyzer.run_statistics.between_runs import student_ends
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.extensions.gates.matching import CELL_LABEL
from dds_trace.tracefile.format.json_fields import object_of

Pairs = Mapping[str, tuple[str, str]]
"""Key -> the names of the cells between which the latency rises."""
Medians = Mapping[str, Mapping[int, float]]
"""Name of a cell -> repeat -> median latency of its run, ns."""
Weights = Mapping[str, float]
"""Name of a cell -> weight of its median."""

LOST_NS = 2e9
"""Latency of a lost message: after as much silence a ping gives it up."""
LEAST_SHARE = 0.25
"""Share of a rise that its cause removes at least."""
AS_IS, MACHINE, NATIVE, CLIENT = "as is", "machine", "native", "client library"
"""Keys besides what is varied: the rise itself, in plain sockets, without the client library, and within it."""
REST, BOTH = "middleware", "middleware and client library"


@dataclass(frozen=True, slots=True)
class Effect:
    """A part of a rise with its interval (None below three repeats), in ns; of a size the factor by which it shrinks."""

    name: str
    value: float
    low: float | None
    high: float | None
    share: float
    is_sure: bool


@dataclass(frozen=True, slots=True)
class Answer:
    rise: Effect
    shares: tuple[Effect, ...]
    removed: tuple[Effect, ...]
    cause: str


def medians_by_cell(side: Analysis) -> dict[str, dict[int, float]]:
    received = pl.when(pl.col("outcome") == "completed").then(pl.coalesce("latency_ns", pl.col("rtt_ns") / 2))
    messages = side.load_messages().select("run_id", received.fill_null(LOST_NS).alias("ns"))
    values = dict(messages.group_by("run_id").agg(pl.col("ns").median()).iter_rows())
    passes = pass_numbers(side.runs)
    medians: dict[str, dict[int, float]] = {}
    for run in side.runs:
        if run.run_id in passes and run.run_id in values:
            medians.setdefault(run.labels.get(CELL_LABEL, ""), {})[passes[run.run_id]] = values[run.run_id]
    return medians


def client_median(breakdown: pl.DataFrame) -> float | None:
    """Return how long messages of one run wait from the middleware's reception to the callback, the mean of both ways, ns."""
    waits = breakdown.filter(pl.col("part").is_in(["relay_delivery_ns", "ping_delivery_ns"]))["p50_ns"]
    return float(waits.sum()) / 2 if len(waits) == 2 and not waits.null_count() else None


def refusals(side: Analysis) -> dict[str, str]:
    reasons = {"awake": "the program that keeps processors awake used none of them"}
    for session in side.sessions:
        listed, load = session.extra.get("not_applied"), object_of(session.extra.get("load"))
        for difference in map(object_of, listed if isinstance(listed, list) else []):
            setting = str(difference.get("setting"))
            reasons[{"kernel_limit": "buffer", "tuned": "buffer"}.get(setting, setting)] = str(difference.get("words"))
        if "realtime_priority" in session.extra and not session.extra.get("realtime_threads"):
            reasons["realtime"] = "no thread of the process ran under SCHED_FIFO at the end"
        if load.get("kind") == "dma-latency" and load.get("program") != "cpu_dma_latency 0 us":
            reasons["dma_latency"] = f"the kernel reports {load.get('program') or 'nothing'}"
        if load.get("kind") == "awake" and load.get("program") and load.get("cpu_s"):
            reasons.pop("awake", None)
    return reasons


def explain(pairs: Pairs, medians: Medians, *, is_ratio: bool, confidence: float = 0.95) -> Answer | None:
    measured = {key: pair for key, pair in pairs.items() if all(medians.get(cell) for cell in pair)}
    rises = {key: {after: 1.0, before: -1.0} for key, (before, after) in measured.items()}
    whole = rises.pop(AS_IS, None)
    sums = _Sums(medians, is_ratio)
    if whole is None or (rise := sums.effect("rise", whole, whole, confidence)) is None:
        return None
    layers = {key: rises.pop(key) for key in (MACHINE, NATIVE, CLIENT) if key in rises}
    adjusted = 1 - (1 - confidence) / max(1, len(rises))
    removed = [sums.effect(name, _minus(whole, varied), whole, adjusted) for name, varied in rises.items()]
    effects = tuple(removal for removal in removed if removal is not None)
    causes = [effect for effect in effects if rise.is_sure and effect.is_sure and effect.share >= LEAST_SHARE]
    cause = max(causes, key=lambda cause_share: cause_share.share).name if causes else ""
    return Answer(rise, () if is_ratio else sums.shares(whole, layers, confidence), effects, cause)


def _minus(whole: Weights, other: Weights) -> dict[str, float]:
    return {cell: whole.get(cell, 0.0) - other.get(cell, 0.0) for cell in {**whole, **other}}


@dataclass(frozen=True, slots=True)
class _Sums:
    medians: Medians
    is_ratio: bool

    def repeats(self, cells: Iterable[str]) -> list[int]:
        return sorted(set.intersection(*(set(self.medians[cell]) for cell in cells)))

    def effect(self, name: str, weights: Weights, whole: Weights, confidence: float) -> Effect | None:
        scale, back = (math.log, math.exp) if self.is_ratio else (float, float)
        repeats = self.repeats({**weights, **whole})
        if not repeats:
            return None

        def sums(terms: Weights) -> list[float]:
            return [sum(w * scale(self.medians[cell][number]) for cell, w in terms.items()) for number in repeats]

        values, total = np.array(sums(weights)), float(np.mean(sums(whole)))
        share = float(values.mean()) / total if total else math.nan
        if len(values) < MIN_RUNS:
            return Effect(name, back(float(values.mean())), None, None, share, is_sure=False)
        value, low, high, _ = student_ends(values, confidence)
        return Effect(name, back(value), back(low), back(high), share, is_sure=low > 0)

    def shares(self, whole: Weights, layers: Mapping[str, Weights], confidence: float) -> tuple[Effect, ...]:
        parts = {key: weights for key, weights in layers.items() if key != NATIVE}
        if NATIVE in layers:
            parts[CLIENT] = _minus(whole, layers[NATIVE])
        remainder = dict(whole)
        for part in parts.values():
            remainder = _minus(remainder, part)
        parts[REST if CLIENT in parts else BOTH] = remainder
        cells = {cell for part in (whole, *parts.values()) for cell in part}
        repeats = self.repeats(cells)
        common = _Sums(
            {cell: {number: self.medians[cell][number] for number in repeats} for cell in cells}, self.is_ratio
        )
        effects = (common.effect(name, part, whole, confidence) for name, part in parts.items())
        return tuple(effect for effect in effects if effect is not None)
