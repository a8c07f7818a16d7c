"""Merge the results of batches: statistics are exact where a batch has whole groups or brings the values of its part.

A sketch merges log-linear histograms (`statistics/histogram.py`): a percentile is off by half a bucket at most,
`RELATIVE_ERROR`. The moments merge without that error (T. Chan, G. Golub and R. LeVeque, 1979).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..groups.batch import Grouping
from ..groups.frames import Frames, concatenate_frames
from ..groups.summary import Statistics, Summary, measure_groups, summarize_groups
from ..loading.event_index import Copies, EventKey
from ..model.metrics import METRICS
from ..statistics.percentiles import Histogram, Sketch, summarize_sketch
from .batches import BatchResult


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    summary: Summary
    frames: Frames
    copies: tuple[Copies, ...]


def merge_results(results: Iterable[BatchResult], grouping: Grouping, *, sketch: bool) -> Merged:
    """Merge results of batches as they come, by group; a part of one brings its values, or histograms for a `sketch`."""
    frames: list[Frames] = []
    counts: list[pl.DataFrame] = []
    copies: dict[EventKey, tuple[Copies, ...]] = {}  # T1 of a run may be in several batches
    statistics: list[Statistics] = []
    spool: _ValueSpool | None = None
    for result in results:
        frames.append(result.frames)
        counts.append(result.counts)
        copies |= result.copies
        if spool and (result.values is None or spool.group != _first_group(result)):
            statistics.append(spool.measure())
            spool = None
        if result.values is None:
            statistics.append(result.statistics)
        else:
            spool = spool or _ValueSpool(_first_group(result))
            spool.add(result.values)
    if spool:
        statistics.append(spool.measure())
    merged = Statistics.concatenate(statistics)
    return Merged(
        summary=summarize_groups(grouping, pl.concat(counts), merge_sketches(merged) if sketch else merged),
        frames=concatenate_frames(frames),
        copies=tuple(copied for copies_of_key in copies.values() for copied in copies_of_key),
    )


def _first_group(result: BatchResult) -> int:
    return int(result.statistics.frame["group"][0])


class _ValueSpool:
    def __init__(self, group: int) -> None:
        self.group = group
        self._folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")

    def add(self, values: Mapping[str, NDArray[np.int64]]) -> None:
        for metric, values_of_part in values.items():
            with self._file(metric).open("ab") as stream:
                stream.write(np.ascontiguousarray(values_of_part).data)

    def measure(self) -> Statistics:
        with self._folder:
            return measure_groups((self.group, metric, self._sorted(metric)) for metric in METRICS)

    def _sorted(self, metric: str) -> NDArray[np.int64]:
        values = np.fromfile(self._file(metric), np.int64)
        values.sort()  # in place: perhaps hundreds of megabytes
        return values

    def _file(self, metric: str) -> Path:
        return Path(self._folder.name) / metric


def merge_sketches(parts: Statistics) -> Statistics:
    distributions = (
        parts.distributions.group_by("group", "metric", "value_ns", maintain_order=True)
        .agg(pl.col("count").sum())
        .sort("value_ns")
    )
    histograms = distributions.partition_by("group", "metric", as_dict=True)
    order = {metric: number for number, metric in enumerate(METRICS)}
    parts_of = parts.frame.partition_by("group", "metric", as_dict=True)
    rows = []
    for group, metric in sorted(parts_of, key=lambda key: (key[0], order[key[1]])):
        row: dict[str, Any] = {"group": group, "metric": metric, "samples": 0}
        values = histograms.get((group, metric))
        if values is not None:
            histogram = Histogram(values["value_ns"].to_numpy(), values["count"].to_numpy())
            sketch = _merged_sketch(parts_of[group, metric], histogram)
            row |= {"samples": sketch.samples, **summarize_sketch(sketch)}
        rows.append(row)
    return Statistics(
        pl.DataFrame(rows, schema=parts.frame.schema),
        distributions.sort("group", pl.col("metric").replace_strict(order), "value_ns"),
    )


def _merged_sketch(parts: pl.DataFrame, histogram: Histogram) -> Sketch:
    samples, mean, squares = 0, 0.0, 0.0
    present = parts.filter(pl.col("samples") > 0)
    for n, mean_of_part, std in present.select("samples", "mean", "std").iter_rows():
        difference = mean_of_part - mean
        squares += (std or 0.0) ** 2 * (n - 1) + difference**2 * samples * n / (samples + n)
        mean += difference * n / (samples + n)
        samples += n
    std = (squares / (samples - 1)) ** 0.5 if samples > 1 else None
    least, most = min(present["min"].to_list()), max(present["max"].to_list())
    return Sketch(samples, mean, std, least, most, histogram)
