"""Numbers of the groups as figures and tables look them up: statistics, their intervals, and curves for drawing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import polars as pl

from dds_trace.analyzer.statistics.intervals import Basis
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.base.units import MISSING

from .groups import METRIC_LABELS, STATISTIC_LABELS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.analyzer.analysis import Analysis

    Ends = Mapping[str, Mapping[str, tuple[int | None, ...]]]


RATIOS_AND_RATES = ("received_ratio", "achieved_rate_hz", "transfer_rate_bytes_per_s")
OWN_COST = ("own_cost_ns", "own_share")
"""What the own nodes take of a round trip; a save of an earlier version does not have them."""
COUNTS = (
    "published",
    "received",
    "lost_outbound",
    "lost_in_relay",
    "lost_return",
    "lost_unknown",
    "duplicates",
    "reordered",
    "runs",
    "planned",
    "unsent",
)


@dataclass(frozen=True, slots=True)
class Values:
    """Numbers of `summary`: item i of each tuple belongs to group i and is None without a value.

    Attributes:
        times_ns: metric -> statistic -> time, rounded to whole nanoseconds.
        plain: the other columns by name (`RATIOS_AND_RATES`, `OWN_COST`, `COUNTS`).
    """

    times_ns: Mapping[str, Mapping[str, tuple[int | None, ...]]]
    plain: Mapping[str, tuple[float | None, ...]]

    def has(self, metric: str) -> bool:
        """Whether any group has a value of the metric."""
        return any(value is not None for column in self.times_ns[metric].values() for value in column)

    def timed(self, group: int) -> bool:
        """Whether any message of the group came back, so that some metric has a time."""
        return any(columns["max"][group] is not None for columns in self.times_ns.values())

    @property
    def default_metric(self) -> str:
        """Metric that a page shows first: latency, or the next metric that was measured."""
        return next((metric for metric in METRIC_LABELS if self.has(metric)), "latency")


def values_info(analysis: Analysis) -> Values:
    """Collect the numbers of `analysis.summary`."""
    return Values(
        times_ns={
            metric: {
                statistic: tuple(
                    None if value is None else round(value)
                    for value in _column(analysis, f"{metric}_{statistic}_ns")
                )
                for statistic in STATISTIC_LABELS
            }
            for metric in METRIC_LABELS
        },
        plain={name: _column(analysis, name) for name in (*RATIOS_AND_RATES, *OWN_COST, *COUNTS)},
    )


def _column(analysis: Analysis, name: str) -> tuple[float | None, ...]:
    """Return a column with None for NaN and infinity, which a report shows as missing; so is a column of a later version."""
    if name not in analysis.summary.columns:
        return (None,) * analysis.summary.height
    return tuple(
        value if value is not None and math.isfinite(value) else None
        for value in analysis.summary[name].to_list()
    )


@dataclass(frozen=True, slots=True)
class Intervals:
    """Ends of the 95 % intervals: metric -> percentile (`p50` to `p99_9`) -> ns per group, None without this end.

    Means and extremes have no interval.

    Attributes:
        low_ns: lower ends.
        high_ns: upper ends.
        episodes: those that the messages beyond each percentile came in, None where no message lies beyond.
        is_between: whether each interval comes from the runs: 1 or 0, None without an interval.
        runs: of each group, 0 where nothing was measured.
    """

    low_ns: Ends
    high_ns: Ends
    episodes: Ends
    is_between: Ends
    runs: tuple[int, ...]

    def tail_episodes(self, metric: str, percentile: str, group: int) -> int | None:
        """Return the episodes that a tail rests on; None of a median, and where no message lies beyond."""
        of_groups = self.episodes.get(metric, {}).get(percentile, ())
        return of_groups[group] if of_groups and percentile != "p50" else None

    def basis(self, metric: str, percentile: str, group: int) -> str:
        """Return on how many runs an interval rests, as in `5` or `1, within one run`; a dash without an interval."""
        is_between = self.is_between.get(metric, {}).get(percentile, ())
        if not is_between or is_between[group] is None:
            return MISSING
        return f"{self.runs[group]}" if is_between[group] else f"{self.runs[group]}, {Basis.WITHIN_RUN.value}"


def intervals_info(analysis: Analysis) -> Intervals:
    """Collect the intervals of the page's metrics; there are none without `analysis.details`."""
    height = analysis.summary.height
    low: dict[str, dict[str, list[int | None]]] = {metric: {} for metric in METRIC_LABELS}
    high: dict[str, dict[str, list[int | None]]] = {metric: {} for metric in METRIC_LABELS}
    episodes: dict[str, dict[str, list[int | None]]] = {metric: {} for metric in METRIC_LABELS}
    is_between: dict[str, dict[str, list[int | None]]] = {metric: {} for metric in METRIC_LABELS}
    runs = [0] * height
    rows = analysis.details.intervals.select(
        "group", "metric", "percentile", "low_ns", "high_ns", "episodes", "runs", "basis"
    )
    for group, metric, percentile, low_ns, high_ns, of_tail, count, basis in rows.iter_rows():
        if metric in METRIC_LABELS:
            runs[group] = max(runs[group], count)
            for column, value in ((episodes, of_tail), (is_between, int(basis == Basis.BETWEEN_RUNS.value))):
                column[metric].setdefault(percentile, [None] * height)[group] = value
            for side, end in ((low, low_ns), (high, high_ns)):
                ends = side[metric].setdefault(percentile, [None] * height)
                ends[group] = None if end is None else round(end)
    return Intervals(_frozen(low), _frozen(high), _frozen(episodes), _frozen(is_between), tuple(runs))


def _frozen(ends: Mapping[str, Mapping[str, list[int | None]]]) -> Ends:
    return {metric: {name: tuple(values) for name, values in of.items()} for metric, of in ends.items()}


# Steps of 5 % for the body, eight steps per decade for the tail up to p99.99.
LEVELS = (
    *(0.0, 0.001, 0.003, 0.01, 0.02, 0.03),
    *(step / 20 for step in range(1, 18)),
    *(round(1 - 10 ** (-step / 8), 6) for step in range(7, 33)),
)


@dataclass(frozen=True, slots=True)
class Curves:
    """Inverse of the cumulated histogram of each group.

    Attributes:
        levels: shares of messages, rising from 0 to 1.
        values_ns: metric -> for each group the values that these shares of messages do not exceed. A tuple ends at
            the last level that the sample supports (level q needs 1 / (1 - q) messages); it is empty if the metric was
            not measured.
        shares: for each group the share of the messages planned that came back, of those that were due: published, or due
            and never left. None without such a message.
    """

    levels: tuple[float, ...]
    values_ns: Mapping[str, tuple[tuple[int, ...], ...]]
    shares: tuple[float | None, ...] = ()


def any_curve(analysis: Analysis) -> bool:
    """Return whether any group has two messages, which a curve needs."""
    messages = analysis.distributions.group_by("group", "metric").agg(pl.sum("count"))["count"]
    return any(count > 1 for count in messages)


def curves_info(analysis: Analysis) -> Curves:
    """Read the curves of all groups from `analysis.distributions`; values are within the histogram's 0.1 %."""
    curves: dict[str, list[tuple[int, ...]]] = {
        metric: [()] * analysis.summary.height for metric in METRIC_LABELS
    }
    ordered = analysis.distributions.sort("group", "metric", "value_ns")
    values_ns, counts = ordered["value_ns"].to_numpy(), ordered["count"].to_numpy().astype(np.int64)
    lengths = ordered.group_by("group", "metric", maintain_order=True).agg(buckets=pl.len())
    start = 0
    for group, metric, buckets in lengths.iter_rows():
        if metric in curves:
            own = slice(start, start + buckets)
            curves[metric][group] = _curve(values_ns[own], counts[own])
        start += buckets
    counts_of = analysis.summary.select("received", "published", "unsent").fill_null(0).iter_rows()
    return Curves(
        LEVELS,
        {metric: tuple(per_group) for metric, per_group in curves.items()},
        tuple(
            received / (published + unsent) if published + unsent else None
            for received, published, unsent in counts_of
        ),
    )


def _curve(values_ns: np.ndarray, counts: np.ndarray) -> tuple[int, ...]:
    """Return the values at the ranks of all levels that the sample supports."""
    ranks = np.cumsum(counts)
    total = int(ranks[-1])
    levels = np.asarray(LEVELS)
    levels = levels[levels <= 1 - 1 / total]
    wanted = np.maximum(1, np.ceil(levels * total - 1e-9))
    at_levels: list[int] = np.rint(values_ns[np.searchsorted(ranks, wanted)]).astype(np.int64).tolist()
    return tuple(at_levels)


Planned: TypeAlias = "Mapping[int, Mapping[str, Mapping[str, int | None]]]"
"""Group -> metric -> statistic -> time in ns over the messages planned; None where that message was lost. A percentile for
which there are too few messages is not there."""


def planned_percentiles(analysis: Analysis) -> Planned:
    """Read the percentiles of the groups that lost messages, each lost or unsent one infinitely late.

    A group that lost nothing has those of `Values`. Values are within the histogram's 0.1 %; means and maxima of what is
    infinite in part are None.
    """
    counts = analysis.summary.select("received", "published", "unsent").fill_null(0).rows()
    planned = {
        group: sent + unsent for group, (got, sent, unsent) in enumerate(counts) if got < sent + unsent
    }
    needs = {percentile.name: percentile.needs for percentile in PERCENTILES}
    of_group: dict[int, dict[str, dict[str, int | None]]] = {
        group: {
            metric: dict.fromkeys(name for name in STATISTIC_LABELS if messages >= needs.get(name, 1))
            for metric in METRIC_LABELS
        }
        for group, messages in planned.items()
    }
    frame = analysis.distributions.filter(pl.col("group").is_in(list(planned))).sort("value_ns")
    for (group, metric), rows in frame.group_by("group", "metric"):
        if metric not in METRIC_LABELS:
            continue
        ranks = np.cumsum(rows["count"].to_numpy())
        values_ns = rows["value_ns"].to_numpy()
        own = of_group[int(str(group))][str(metric)]
        own["min"] = round(float(values_ns[0]))
        for percentile in PERCENTILES:
            rank = max(1, math.ceil(percentile.quantile * planned[int(str(group))] - 1e-9))
            if percentile.name in own and rank <= ranks[-1]:
                own[percentile.name] = round(float(values_ns[np.searchsorted(ranks, rank)]))
    return of_group


def whole_ns(value_ns: float | None) -> int | None:
    """Round a number of a frame to whole nanoseconds; None for null, NaN and infinity."""
    return None if value_ns is None or not math.isfinite(value_ns) else round(value_ns)
