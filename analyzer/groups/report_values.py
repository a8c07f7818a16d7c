"""Values of groups that only reports show: curves, percentiles over the planned messages, shares, load of bridges."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..model.metrics import METRICS
from ..statistics.percentiles import PERCENTILES

_DECADES = 1 + round(math.log10(PERCENTILES[-1].needs))
LEVELS = (
    *(0.0, 0.001, 0.003, 0.01, 0.02, 0.03),
    *(step / 20 for step in range(1, 18)),
    *(round(1 - 10 ** (-step / 8), 6) for step in range(7, 8 * _DECADES + 1)),
)
"""Shares of messages at which a curve has a point: steps of 5 %, and eight steps per decade of the tail, to one beyond the rarest percentile."""


def curves(distributions: pl.DataFrame) -> dict[tuple[int, str], tuple[int, ...]]:
    """Return by group and metric the times, ns, of the `LEVELS` for which there are messages enough, within 0.1 %."""
    ordered = distributions.sort("group", "metric", "value_ns")
    values_ns, counts = ordered["value_ns"].to_numpy(), ordered["count"].to_numpy().astype(np.int64)
    lengths = ordered.group_by("group", "metric", maintain_order=True).agg(buckets=pl.len())
    curve_of, start = {}, 0
    for group, metric, buckets in lengths.iter_rows():
        part = slice(start, start + buckets)
        curve_of[group, metric] = _curve(values_ns[part], counts[part])
        start += buckets
    return curve_of


def _curve(values_ns: NDArray[np.float64], counts: NDArray[np.int64]) -> tuple[int, ...]:
    ranks = np.cumsum(counts)
    total = int(ranks[-1])
    levels = np.asarray(LEVELS)
    levels = levels[levels <= 1 - 1 / total]
    at_levels = np.searchsorted(ranks, np.maximum(1, np.ceil(levels * total - 1e-9)))
    return tuple(np.rint(values_ns[at_levels]).astype(np.int64).tolist())


Planned: TypeAlias = "dict[int, dict[str, dict[str, int | None]]]"
"""Group -> metric -> statistic -> time in ns over the planned messages; None where that message was lost, missing where
there are too few messages for a percentile."""


def planned_percentiles(summary: pl.DataFrame, distributions: pl.DataFrame) -> Planned:
    """Read the percentiles of the groups that lost messages, each lost or unsent one infinitely late.

    Values are within the histogram's 0.1 %; a mean or maximum of what is infinite in part is None.
    """
    counts = summary.select("received", "published", "unsent").fill_null(0).rows()
    planned = {i: sent + unsent for i, (received, sent, unsent) in enumerate(counts) if received < sent + unsent}
    needs = {"mean": 1, "min": 1, "max": 1, **{percentile.name: percentile.needs for percentile in PERCENTILES}}
    result: Planned = {
        group: {metric: dict.fromkeys(name for name in needs if messages >= needs[name]) for metric in METRICS}
        for group, messages in planned.items()
    }
    histograms = distributions.filter(pl.col("group").is_in(list(planned))).sort("value_ns")
    for (group, metric), rows in histograms.group_by("group", "metric"):
        times = result[int(str(group))][str(metric)]
        values_ns, ranks = rows["value_ns"].to_numpy(), np.cumsum(rows["count"].to_numpy())
        times["min"] = round(float(values_ns[0]))
        for percentile in PERCENTILES:
            rank = max(1, math.ceil(percentile.quantile * planned[int(str(group))] - 1e-9))
            if percentile.name in times and rank <= ranks[-1]:
                times[percentile.name] = round(float(values_ns[np.searchsorted(ranks, rank)]))
    return result


def planned_shares(summary: pl.DataFrame) -> tuple[float | None, ...]:
    """Received share of the messages that were due, sent or not, by group; None where none was due."""
    due = pl.col("published") + pl.col("unsent").fill_null(0)
    return tuple(summary.select(pl.when(due > 0).then(pl.col("received") / due)).to_series().to_list())


def sustained_shares(summary: pl.DataFrame) -> tuple[float | None, ...]:
    """Replies per second as a share of the requested rate, by group; None where a factor is unknown."""
    share = pl.col("achieved_rate_hz") * pl.col("received_ratio") / pl.col("rate_hz")
    return tuple(summary.select(pl.when(pl.col("rate_hz") > 0).then(share)).to_series().to_list())


class RunSpan(NamedTuple):
    """First and last message of a run of a group, monotonic clock of the ping's session, ns."""

    group: int
    session_id: int
    first_ns: int
    last_ns: int


def bridge_loads(samples: pl.DataFrame, runs: Iterable[RunSpan]) -> Mapping[int, float]:
    """Average the bridges' load in `Details.host_samples`, percent of one processor, over the runs of each group with samples."""
    by_session = samples.filter(pl.col("bridge_cpu_percent").is_not_null()).partition_by("session_id", as_dict=True)
    loads: dict[int, list[float]] = {}
    for run in runs:
        if (run.session_id,) in by_session:
            during = by_session[run.session_id,].filter(pl.col("monotonic_ns").is_between(run.first_ns, run.last_ns))
            loads.setdefault(run.group, []).extend(during["bridge_cpu_percent"].to_list())
    return {group: round(float(np.mean(values)), 1) for group, values in loads.items() if values}
