"""Numbers of the groups as figures and tables look them up: statistics, their intervals, and curves for drawing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from .groups import METRICS, STATISTICS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.analyzer.analysis import Analysis

    Ends = Mapping[str, Mapping[str, tuple[int | None, ...]]]


RATIOS_AND_RATES = ("received_ratio", "achieved_rate_hz", "transfer_rate_bytes_per_s")
COUNTS = (
    "published",
    "received",
    "lost_outbound",
    "lost_in_relay",
    "lost_return",
    "lost_unknown",
    "duplicates",
    "reordered",
)


@dataclass(frozen=True, slots=True)
class Values:
    """Every number of `summary`; position i of every tuple is group i, None where there is no value.

    Attributes:
        times_ns: metric -> statistic -> ns, rounded to whole nanoseconds.
        plain: the other columns by name (`RATIOS_AND_RATES`, `COUNTS`).
    """

    times_ns: Mapping[str, Mapping[str, tuple[int | None, ...]]]
    plain: Mapping[str, tuple[float | None, ...]]

    def has(self, metric: str) -> bool:
        """Whether any group has a value of the metric."""
        return any(value is not None for column in self.times_ns[metric].values() for value in column)

    def timed(self, group: int) -> bool:
        """Whether the group has a time of any metric: whether anything came back."""
        return any(columns["max"][group] is not None for columns in self.times_ns.values())

    @property
    def default_metric(self) -> str:
        """What a page shows first: the latency, or the next metric that was measured at all."""
        return next((metric for metric in METRICS if self.has(metric)), "latency")


def values_info(analysis: Analysis) -> Values:
    """The numbers of `analysis.summary`."""
    return Values(
        times_ns={
            metric: {
                statistic: tuple(
                    None if value is None else round(value)
                    for value in _column(analysis, f"{metric}_{statistic}_ns")
                )
                for statistic in STATISTICS
            }
            for metric in METRICS
        },
        plain={name: _column(analysis, name) for name in (*RATIOS_AND_RATES, *COUNTS)},
    )


def _column(analysis: Analysis, name: str) -> tuple[float | None, ...]:
    """A column without NaN or infinity; both mean that there is no number."""
    return tuple(
        value if value is not None and math.isfinite(value) else None
        for value in analysis.summary[name].to_list()
    )


@dataclass(frozen=True, slots=True)
class Intervals:
    """Ends of 95 % intervals: metric -> percentile (`p50` ... `p99_9`) -> per group ns, None without this end.

    Means and extremes have none.
    """

    low_ns: Ends
    high_ns: Ends


def intervals_info(analysis: Analysis) -> Intervals:
    """The metrics of the page; no interval at all where the analysis was made without details."""
    height = analysis.summary.height
    low: dict[str, dict[str, list[int | None]]] = {metric: {} for metric in METRICS}
    high: dict[str, dict[str, list[int | None]]] = {metric: {} for metric in METRICS}
    if analysis.details is not None:
        rows = analysis.details.intervals.select("group", "metric", "percentile", "low_ns", "high_ns")
        for group, metric, percentile, low_ns, high_ns in rows.iter_rows():
            if metric in METRICS:
                for side, end in ((low, low_ns), (high, high_ns)):
                    ends = side[metric].setdefault(percentile, [None] * height)
                    ends[group] = None if end is None else round(end)
    return Intervals(_frozen(low), _frozen(high))


def _frozen(ends: Mapping[str, Mapping[str, list[int | None]]]) -> Ends:
    return {metric: {name: tuple(values) for name, values in of.items()} for metric, of in ends.items()}


# Even steps for the body, eight steps per decade of the tail up to p99.99.
LEVELS = (
    *(0.0, 0.001, 0.003, 0.01, 0.02, 0.03),
    *(step / 20 for step in range(1, 18)),
    *(round(1 - 10 ** (-step / 8), 6) for step in range(7, 33)),
)


@dataclass(frozen=True, slots=True)
class Curves:
    """The inverse of each group's cumulated histogram.

    Attributes:
        levels: shares of messages, ascending.
        values_ns: metric -> per group the values that these shares stay below or reach. A list ends where the sample
            does: level q takes 1 / (1 - q) messages. Empty where the metric was not measured.
    """

    levels: tuple[float, ...]
    values_ns: Mapping[str, tuple[tuple[int, ...], ...]]


def any_curve(analysis: Analysis) -> bool:
    """Whether some group has two messages at least, and so a curve."""
    messages = analysis.distributions.group_by("group", "metric").agg(pl.sum("count"))["count"]
    return any(count > 1 for count in messages)


def curves_info(analysis: Analysis) -> Curves:
    """Every group's curves, from `analysis.distributions`; a value is exact to the histogram's 0.1 %."""
    curves: dict[str, list[tuple[int, ...]]] = {metric: [()] * analysis.summary.height for metric in METRICS}
    ordered = analysis.distributions.sort("group", "metric", "value_ns")
    values_ns, counts = ordered["value_ns"].to_numpy(), ordered["count"].to_numpy().astype(np.int64)
    lengths = ordered.group_by("group", "metric", maintain_order=True).agg(buckets=pl.len())
    start = 0
    for group, metric, buckets in lengths.iter_rows():
        if metric in curves:
            own = slice(start, start + buckets)
            curves[metric][group] = _curve(values_ns[own], counts[own])
        start += buckets
    return Curves(LEVELS, {metric: tuple(per_group) for metric, per_group in curves.items()})


def _curve(values_ns: np.ndarray, counts: np.ndarray) -> tuple[int, ...]:
    """The value whose rank is the level's share of all, for each level that the sample supports."""
    ranks = np.cumsum(counts)
    total = int(ranks[-1])
    levels = np.asarray(LEVELS)
    levels = levels[levels <= 1 - 1 / total]
    wanted = np.maximum(1, np.ceil(levels * total - 1e-9))
    at_levels: list[int] = np.rint(values_ns[np.searchsorted(ranks, wanted)]).astype(np.int64).tolist()
    return tuple(at_levels)


def whole_ns(value_ns: float | None) -> int | None:
    """Round a number of a frame to whole nanoseconds; None for null, NaN and infinity."""
    return None if value_ns is None or not math.isfinite(value_ns) else round(value_ns)
