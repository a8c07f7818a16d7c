"""Distributions thinned for drawing: each group's histogram, read off at levels that suit both of its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from .groups import METRICS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.analyzer.analysis import Analysis

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
