"""The frames `intervals`, `one_way` and `clock_knots`: percentiles with their confidence, and with what clocks allow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..model.metrics import METRICS
from ..pairing.one_way import knots_of
from ..statistics.intervals import percentile_interval
from ..statistics.percentiles import PERCENTILES, summarize_values
from .batch import rows_by_group

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

INTERVAL_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "metric": pl.String,
    "percentile": pl.String,
    "quantile": pl.Float64,
    "estimate_ns": pl.Float64,
    "low_ns": pl.Float64,
    "high_ns": pl.Float64,
    "method": pl.String,
    "confidence": pl.Float64,
    "messages": pl.UInt64,
    "independent": pl.UInt64,
}

ONE_WAY_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "metric": pl.String,
    "messages": pl.UInt64,
    "mean_ns": pl.Float64,
    "min_ns": pl.Float64,
    **{f"{p.name}_ns": pl.Float64 for p in PERCENTILES},
    "max_ns": pl.Float64,
    "bound_p50_ns": pl.Float64,
    "bound_max_ns": pl.Float64,
}

ONE_WAY_METRICS = ("outbound", "return")


def interval_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Compute every percentile of every metric with its 95 % interval by order statistics.

    Returns:
        Columns of `INTERVAL_SCHEMA`, five rows per group and metric that has a value (`METRICS`, `outbound`,
        `return`). `estimate_ns` is the summary's percentile; `low_ns`, `high_ns` are null where the sample does not
        support that end, all three where it does not support the percentile. `method` is `order_statistics`, null
        without both ends. `independent`: number of independent messages that the sample is worth.
    """
    rows = [
        row
        for group, part in rows_by_group(batch, roundtrips)
        for row in interval_rows(group, part.get_column)
    ]
    return pl.DataFrame(rows, schema=INTERVAL_SCHEMA)


def interval_rows(group: int, column: Callable[[str], pl.Series]) -> Iterator[dict[str, object]]:
    """Yield the rows of `interval_frame` for one group, whose columns are fetched one by one."""
    for metric in (*METRICS, *ONE_WAY_METRICS):
        values = column(f"{metric}_ns").drop_nulls().to_numpy()
        if not len(values):
            continue
        ordered = np.sort(values)
        for percentile in PERCENTILES:
            interval = percentile_interval(values, percentile.quantile, ordered=ordered)
            yield {
                "group": group,
                "metric": metric,
                "percentile": percentile.name,
                "quantile": percentile.quantile,
                "estimate_ns": interval.value,
                "low_ns": interval.lower,
                "high_ns": interval.upper,
                "method": "order_statistics" if interval.is_two_sided else None,
                "confidence": interval.confidence,
                "messages": interval.samples,
                "independent": interval.independent,
            }


def one_way_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Summarize the way out and the way back of each group whose messages have all four stamps.

    Returns:
        Columns of `ONE_WAY_SCHEMA`, rows `outbound` and `return`: percentiles as in the summary, and how far a
        message's one-way time may be off (`bound_p50_ns`, `bound_max_ns`; 0 on one clock).
    """
    rows = [
        row
        for group, part in rows_by_group(batch, roundtrips)
        for row in one_way_rows(group, part.get_column)
    ]
    return pl.DataFrame(rows, schema=ONE_WAY_SCHEMA)


def one_way_rows(group: int, column: Callable[[str], pl.Series]) -> Iterator[dict[str, object]]:
    """Yield the rows of `one_way_frame` for one group, whose columns are fetched one by one."""
    bounds = column("clock_bound_ns").drop_nulls()
    for metric in ONE_WAY_METRICS if len(bounds) else ():
        statistics = summarize_values(column(f"{metric}_ns").drop_nulls().sort().to_numpy())
        yield (
            {"group": group, "metric": metric, "messages": len(bounds)}
            | {f"{name}_ns": value for name, value in statistics.items() if name != "std"}
            | {"bound_p50_ns": bounds.median(), "bound_max_ns": bounds.max()}
        )


def knot_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """List the knots of the clock fits: columns of `one_way.KNOT_SCHEMA`, a row per run, relay and window."""
    return knots_of(batch.exchanges, batch.group_of_exchange.tolist(), roundtrips.clock_fits)
