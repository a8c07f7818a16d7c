"""The columns of a comparison's frames, and the verdict on each result of both sides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from dds_trace.analyzer.model.metrics import frame_schema
from dds_trace.analyzer.run_statistics.change import Verdict
from dds_trace.analyzer.run_statistics.runs import Values
from dds_trace.analyzer.statistics.intervals import Basis
from dds_trace.analyzer.statistics.power import benjamini_hochberg_adjusted
from dds_trace.analyzer.verdicts.judgements import Row

DISTRIBUTION_LEVELS = (0.0, 0.01, 0.025, *(n / 20 for n in range(1, 20)), 0.975, 0.99, 0.995, 0.999)

DELIVERY_SCHEMA = frame_schema(
    "base_published:u64 base_received_ratio:f64 base_received_ratio_low:f64 base_received_ratio_high:f64 new_published:u64 "
    "new_received_ratio:f64 new_received_ratio_low:f64 new_received_ratio_high:f64 difference:f64 difference_low:f64 "
    "difference_high:f64 verdict:str basis:str base_runs:u64 new_runs:u64 is_dead:bool environment:str smallest_drop:f64 "
    "p_value:f64 p_adjusted:f64"
)

DISTRIBUTION_SCHEMA: dict[str, type[pl.DataType] | pl.DataType] = {
    "metric": pl.String,
    "base_ns": pl.List(pl.Float64),
    "new_ns": pl.List(pl.Float64),
}
"""One metric of one matched group: the times in ns at the first of `DISTRIBUTION_LEVELS`, infinite for lost messages, as far as the
messages suffice."""


def with_clock_bounds(row: dict[str, Any], base_ns: int, new_ns: int) -> dict[str, Any]:
    """Widen the intervals of a row by the largest error of each side's clocks; a difference within both is no verdict."""
    if not base_ns and not new_ns:
        return row
    both_ns = base_ns + new_ns
    share = both_ns / row["base_ns"] if row["base_ns"] else math.inf
    widened = dict(row)
    for name, by in (("base{}_ns", base_ns), ("new{}_ns", new_ns), ("difference{}_ns", both_ns), ("ratio{}", share)):
        low, high = name.format("_low"), name.format("_high")
        widened |= {low: _moved(row[low], -by), high: _moved(row[high], by)}
    if row["ratio_low"] is not None:
        widened["ratio_low"] = max(0.0, widened["ratio_low"])
    if row["difference_ns"] is not None and abs(row["difference_ns"]) <= both_ns and row["verdict"] in _DIFFERENT:
        widened["verdict"] = Verdict.INCONCLUSIVE.value
    return widened


_DIFFERENT = (Verdict.BETTER.value, Verdict.WORSE.value)


def _moved(end: float | None, by: float) -> float | None:
    return None if end is None else end + by


def at_levels(ordered: Values) -> tuple[float, ...]:
    if not len(ordered):
        return ()
    levels = np.asarray(DISTRIBUTION_LEVELS)
    levels = levels[levels <= 1 - 1 / len(ordered)]
    ranks = np.maximum(1, np.ceil(levels * len(ordered) - 1e-9)).astype(np.int64)
    return tuple(float(value) for value in ordered[ranks - 1])


def with_adjusted_verdicts(rows: pl.DataFrame, confidence: float) -> pl.DataFrame:
    """Adjust the p values of all rows by Benjamini and Hochberg; what is better or worse by chance is inconclusive."""
    tested = rows["p_value"].drop_nulls()
    adjusted = iter(benjamini_hochberg_adjusted(tested.to_list()).tolist())
    p_adjusted = [None if p is None else next(adjusted) for p in rows["p_value"]]
    is_unsure = pl.col("verdict").is_in([Verdict.BETTER.value, Verdict.WORSE.value]) & (
        pl.col("p_adjusted").fill_null(0.0) > 1 - confidence
    )
    verdict = pl.when(is_unsure).then(pl.lit(Verdict.INCONCLUSIVE.value)).otherwise("verdict")
    return rows.with_columns(pl.Series("p_adjusted", p_adjusted, pl.Float64)).with_columns(verdict.alias("verdict"))


SHOWN_STATISTICS = ("p50", "p99")

WORST_FIRST = (
    "no reply came back",
    "loses more",
    "slower",
    "no clear change",
    "undecided",
    "too few runs",
    "the same",
    "loses less",
    "faster",
)
"""Verdicts on one result of both sides."""


def shown_changes(changes: Sequence[Row]) -> tuple[Row, ...]:
    first_metric = [row for row in changes if row["metric"] == changes[0]["metric"]]
    return tuple(row for row in first_metric if row["statistic"] in SHOWN_STATISTICS) or tuple(first_metric[:1])


def verdict_of_result(delivery: Row, changes: Sequence[Row], *, is_busier: bool) -> str:
    verdicts = {row["verdict"] for row in changes}
    rules = (
        (delivery["is_dead"], "no reply came back"),
        (is_busier, "undecided"),
        (delivery["verdict"] == Verdict.WORSE.value, "loses more"),
        (Verdict.WORSE.value in verdicts, "slower"),
        (all(row["basis"] == Basis.WITHIN_RUN.value for row in changes), "too few runs"),
        (delivery["verdict"] == Verdict.BETTER.value, "loses less"),
        (Verdict.BETTER.value in verdicts, "faster"),
        ({row["verdict"] for row in shown_changes(changes)} == {Verdict.SAME.value}, "the same"),
    )
    return next((words for applies, words in rules if applies), "no clear change")
