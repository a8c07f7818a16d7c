"""The frame `intervals`: every percentile of every metric with its confidence interval."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..model.metrics import METRICS
from ..statistics.intervals import percentile_interval
from ..statistics.percentiles import PERCENTILES
from .batch import rows_by_group
from .one_way import ONE_WAY_METRICS

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


def interval_frame(batch: Batch, roundtrips: RoundTrips) -> pl.DataFrame:
    """Compute every percentile of every metric with its 95 % interval by order statistics.

    Returns:
        Columns of `INTERVAL_SCHEMA`, five rows per group and metric that has a value (`METRICS`, `outbound`,
        `return`). `estimate_ns` is the summary's percentile; `low_ns`, `high_ns` are null where the sample does not
        support that end, all three where it does not support the percentile. `method` is `order_statistics`, null
        without both ends. `independent`: how many independent messages the sample is worth.
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
