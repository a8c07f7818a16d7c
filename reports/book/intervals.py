"""Confidence intervals of the percentiles (`details.intervals`), as figures and tables look them up by group."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .groups import METRICS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.analyzer.analysis import Analysis

    Ends = Mapping[str, Mapping[str, tuple[int | None, ...]]]


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
