"""The frame `timeline`: round trips over the run's time, few enough to draw, with extremes and losses kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from analyzer.pair import Outcome

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analyzer.roundtrips import RoundTrips


_ALL_POINTS = 100_000
_POINTS_OF_EXCHANGE = (200, 4_000)
"""An exchange gets its share of all points, but at least and at most so many."""

_KEPT_PER_STRETCH = 4
"""Lowest, highest, first loss, and the one that a second kind of loss may add."""


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """`analysis.Analysis.timeline`, and whether rows were left out of it."""

    frame: pl.DataFrame
    decimated: bool


def draw_timeline(roundtrips: RoundTrips, group_of_exchange: NDArray[np.uint32]) -> Timeline:
    """Rows of `roundtrips` worth drawing.

    An exchange with more rows than its share of points is cut into stretches of equal length. Each keeps
    its lowest and its highest round trip and the first message of every kind of loss in it: a curve drawn
    through these covers what a curve through all rows would cover.

    Returns:
        Columns `group` u32, `run_id` u64, `relay_id` u32, `sequence` u64, `elapsed_s` f64 (T0, or T1 where
        there was no schedule, since that of the run's first counted message), `latency_ns` i64 null,
        `rtt_ns` i64 null, `outcome` str.
    """
    exchanges = len(roundtrips.exchanges)
    low, high = _POINTS_OF_EXCHANGE
    share = min(max(_ALL_POINTS // max(exchanges, 1), low), high)
    kept = [
        int(first) + _worth_drawing(roundtrips.frame[int(first) : int(after)], share)
        for first, after in zip(roundtrips.bounds[:-1], roundtrips.bounds[1:], strict=True)
    ]
    rows = np.concatenate([np.empty(0, np.int64), *kept])
    counts = [len(of_exchange) for of_exchange in kept]
    drawn = roundtrips.frame[rows].with_columns(
        pl.Series("group", np.repeat(group_of_exchange, counts)),
        pl.Series("_exchange", np.repeat(np.arange(exchanges), counts)),
        pl.coalesce("scheduled_ns", "publish_ns").alias("_planned_ns"),
    )
    # The first counted message of a run is always among the rows kept.
    elapsed_ns = pl.col("_planned_ns") - pl.col("_planned_ns").first().over("_exchange")
    frame = drawn.select(
        "group",
        "run_id",
        "relay_id",
        "sequence",
        (elapsed_ns / 1e9).alias("elapsed_s"),
        "latency_ns",
        "rtt_ns",
        "outcome",
    )
    return Timeline(frame, decimated=frame.height < roundtrips.frame.height)


def _worth_drawing(rows: pl.DataFrame, share: int) -> NDArray[np.int64]:
    """Positions in `rows` to keep, rising; all of them if there are no more than `share`."""
    n = rows.height
    if n <= share:
        return np.arange(n)
    position = pl.int_range(pl.len(), dtype=pl.Int64)
    numbered = rows.lazy().select(
        position.alias("position"),
        (position * (share // _KEPT_PER_STRETCH) // n).alias("stretch"),
        pl.col("rtt_ns" if rows["latency_ns"].null_count() == n else "latency_ns").alias("drawn_ns"),
        "outcome",
    )
    extremes = (
        numbered.drop_nulls("drawn_ns")
        .group_by("stretch")
        .agg(
            pl.col("position").get(pl.col("drawn_ns").arg_min()).alias("lowest"),
            pl.col("position").get(pl.col("drawn_ns").arg_max()).alias("highest"),
        )
    ).collect()
    losses = (
        numbered.filter(pl.col("outcome") != Outcome.COMPLETED.value)
        .group_by("stretch", "outcome")
        .agg(pl.col("position").min())
    ).collect()
    kept = [np.zeros(1, np.int64), *(extremes[name].to_numpy() for name in ("lowest", "highest"))]
    return np.unique(np.concatenate([*kept, losses["position"].to_numpy()]))
