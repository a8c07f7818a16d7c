"""Statistics of groups whose rows are not all in memory: exact from their values, or approximate from histograms.

The histograms are integer log-linear ones (`analyzer/statistics/histogram.py`): counts of equal buckets add up, so merging
loses nothing, and a percentile is off by half a bucket at most, `RELATIVE_ERROR` of its value. Counts, mean, standard
deviation and extremes merge without that error (Chan, Golub and LeVeque, "Updating formulae and a pairwise algorithm
for computing sample variances", 1979).
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..groups.summary import Statistics, measure_groups
from ..model.metrics import METRICS
from ..statistics.percentiles import PERCENTILES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


class ValueSpool:
    """The values of one group that comes in parts: in a file for each metric, so that one at a time is in memory."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")

    def add(self, values: Mapping[str, NDArray[np.int64]]) -> None:
        """Append the values of one part of the group, by metric."""
        for metric, of_part in values.items():
            with self._file(metric).open("ab") as stream:
                stream.write(np.ascontiguousarray(of_part).data)

    def measure(self, group: int) -> Statistics:
        """Return exact statistics of all parts, and remove the files."""
        with self._folder:
            return measure_groups((group, metric, self._values(metric)) for metric in METRICS)

    def _values(self, metric: str) -> NDArray[np.int64]:
        values = np.fromfile(self._file(metric), np.int64)
        values.sort()  # in place: there may be hundreds of megabytes
        return values

    def _file(self, metric: str) -> Path:
        return Path(self._folder.name) / metric


def merge_sketches(parts: Statistics) -> Statistics:
    """Merge statistics of parts of groups: percentiles by histogram, all else as if the groups were whole.

    Args:
        parts: rows and histograms of any number of parts of each group, in any order.
    """
    moments = {
        key: merge_moments(frame)
        for key, frame in parts.frame.partition_by(
            "group", "metric", as_dict=True, maintain_order=True
        ).items()
    }
    distributions = (
        parts.distributions.group_by("group", "metric", "value_ns", maintain_order=True)
        .agg(pl.col("count").sum())
        .sort("value_ns")
    )
    histograms = distributions.partition_by("group", "metric", as_dict=True)
    rows = []
    for group, metric in sorted(moments, key=lambda key: (key[0], list(METRICS).index(key[1]))):
        row = {"group": group, "metric": metric, **moments[group, metric]}
        histogram = histograms.get((group, metric))
        if histogram is not None:
            value_ns, count = histogram["value_ns"].to_numpy(), histogram["count"].to_numpy()
            row |= {
                p.name: _within(histogram_percentile(value_ns, count, p.quantile), row)
                for p in PERCENTILES
                if count.sum() >= p.needs
            }
        rows.append(row)
    order = {metric: position for position, metric in enumerate(METRICS)}
    return Statistics(
        pl.DataFrame(rows, schema=parts.frame.schema),
        distributions.sort("group", pl.col("metric").replace_strict(order), "value_ns"),
    )


def merge_moments(parts: pl.DataFrame) -> dict[str, float | None]:
    """Merge samples, mean, standard deviation, least and largest value of the parts of one group and metric."""
    samples, mean, squares = 0, 0.0, 0.0
    for n, of_part, std in parts.filter(pl.col("samples") > 0).select("samples", "mean", "std").iter_rows():
        apart = of_part - mean
        squares += (std or 0.0) ** 2 * (n - 1) + apart**2 * samples * n / (samples + n)
        mean += apart * n / (samples + n)
        samples += n
    return {
        "samples": samples,
        "mean": mean if samples else None,
        "std": (squares / (samples - 1)) ** 0.5 if samples > 1 else None,
        "min": parts["min"].min(),  # type: ignore[dict-item]
        "max": parts["max"].max(),  # type: ignore[dict-item]
    }


def histogram_percentile(value_ns: NDArray[np.float64], count: NDArray[np.uint64], quantile: float) -> float:
    """Interpolate a percentile of the counted values, each taken to be the centre of its bucket.

    Args:
        value_ns: centres of the buckets, rising.
        count: values in each, at least one in all.
        quantile: 0 to 1.
    """
    behind = np.cumsum(count.astype(np.int64))
    position = quantile * (int(behind[-1]) - 1)
    below = int(position)
    low, high = (
        float(value_ns[np.searchsorted(behind, min(rank, int(behind[-1]) - 1), side="right")])
        for rank in (below, below + 1)
    )
    return low + (high - low) * (position - below)


def _within(value_ns: float, row: Mapping[str, float | str | int | None]) -> float:
    """Limit a percentile to the range of the values: the centre of a bucket may lie beyond it."""
    low, high = row["min"], row["max"]
    assert isinstance(low, float)
    assert isinstance(high, float)
    return min(max(value_ns, low), high)
