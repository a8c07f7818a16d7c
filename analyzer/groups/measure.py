"""Statistics and histograms of the metrics of some groups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..model.columns import STATISTICS
from ..model.metrics import METRICS
from ..statistics.histogram import Histogram, histogram_of
from ..statistics.percentiles import summarize_values
from .batch import present

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from ..pairing.roundtrips import PairedRows

_STATISTICS_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "metric": pl.String,
    "samples": pl.Int64,
    **dict.fromkeys(STATISTICS, pl.Float64),
}


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Statistics and histograms of some groups.

    Attributes:
        frame: one row per group and metric: `group` u32, `metric` str, `samples` i64, and `columns.STATISTICS`, f64 ns, null
            where the sample does not support it.
        distributions: `group` u32, `metric` str, `value_ns` f64, `count` u64: histograms.
    """

    frame: pl.DataFrame
    distributions: pl.DataFrame

    @classmethod
    def concatenate(cls, parts: Sequence[Statistics]) -> Statistics:
        """Concatenate the frames of all parts."""
        return cls(pl.concat([p.frame for p in parts]), pl.concat([p.distributions for p in parts]))


def metric_values(roundtrips: PairedRows, metric: str, first: int, after: int) -> NDArray[np.int64]:
    """Return the values of a metric of exchanges `first` to `after` (not included), without nulls."""
    rows = roundtrips.bounds[[first, after]].tolist()
    return present(roundtrips.column(f"{metric}_ns").slice(rows[0], rows[1] - rows[0]))


def measure_batch(roundtrips: PairedRows, group_of_exchange: NDArray[np.uint32]) -> Statistics:
    """Measure every group of a batch, in ascending order."""
    groups, first = np.unique(group_of_exchange, return_index=True)
    after = np.append(first[1:], len(group_of_exchange))
    return measure_groups(
        (group, metric, np.sort(metric_values(roundtrips, metric, start, stop)))
        for group, start, stop in zip(groups.tolist(), first.tolist(), after.tolist(), strict=True)
        for metric in METRICS
    )


def measure_groups(values: Iterable[tuple[int, str, NDArray[np.int64]]]) -> Statistics:
    """Compute statistics and histograms from (group, metric, values ascending)."""
    rows, histograms = [], []
    for group, metric, ordered_ns in values:
        rows.append(
            {"group": group, "metric": metric, "samples": len(ordered_ns), **summarize_values(ordered_ns)}
        )
        histograms.append((group, metric, histogram_of(ordered_ns)))
    return Statistics(pl.DataFrame(rows, schema=_STATISTICS_SCHEMA), _distributions(histograms))


def _distributions(histograms: list[tuple[int, str, Histogram]]) -> pl.DataFrame:
    lengths = [len(histogram.value_ns) for _, _, histogram in histograms]
    index = np.repeat(np.arange(len(histograms), dtype=np.uint32), lengths)
    return pl.DataFrame(
        {
            "group": pl.Series([group for group, _, _ in histograms], dtype=pl.UInt32).gather(index),
            "metric": pl.Series([metric for _, metric, _ in histograms], dtype=pl.String).gather(index),
            "value_ns": np.concatenate([np.empty(0), *(h.value_ns for _, _, h in histograms)]),
            "count": np.concatenate([np.empty(0, np.uint64), *(h.count for _, _, h in histograms)]),
        }
    )
