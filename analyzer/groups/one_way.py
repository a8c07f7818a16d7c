"""The frames `one_way` and `clock_knots`: the ways out and back, and the clock offsets that they rest on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from ..pairing.one_way import knots_of
from ..statistics.percentiles import PERCENTILES, summarize_values
from .batch import rows_by_group

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ..pairing.roundtrips import RoundTrips
    from .batch import Batch

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
    """Return what the runs know best of the clocks: columns of `one_way.KNOT_SCHEMA`, a row per run, relay and window."""
    return knots_of(batch.exchanges, batch.group_of_exchange.tolist(), roundtrips.clock_fits)
