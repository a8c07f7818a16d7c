"""Merge the results of batches: exact where they brought values, by histograms where they did not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from ..groups.frames import concatenate_frames
from ..groups.measure import Statistics
from ..groups.summary import summarize_groups
from .oversized import ValueSpool, merge_sketches

if TYPE_CHECKING:
    from ..groups.frames import Frames
    from ..groups.grouping import Grouping
    from ..groups.summary import Summary
    from ..loading.events import Copies, EventKey
    from .batches import BatchResult


class MergedResults:
    """Takes the results of batches in the order of groups.

    Args:
        sketch: take percentiles from histograms, also of groups that were held whole.

    Attributes:
        rows: number of rows of all batches.
    """

    def __init__(self, *, sketch: bool) -> None:
        self._sketch = sketch
        self._frames: list[Frames] = []
        self._counts: list[pl.DataFrame] = []
        self._statistics: list[Statistics] = []
        self._copies: dict[EventKey, tuple[Copies, ...]] = {}  # T1 of a run may be in several batches
        self._spool: tuple[int, ValueSpool] | None = None
        self.rows = 0

    def add(self, result: BatchResult) -> None:
        """Take the next batch."""
        self.rows += result.rows
        self._frames.append(result.frames)
        self._counts.append(result.counts)
        self._copies |= result.copies
        group = int(result.statistics.frame["group"][0])
        if self._spool and (result.values is None or self._spool[0] != group):
            self._unspool()
        if result.values is None:
            self._statistics.append(result.statistics)
            return
        if self._spool is None:
            self._spool = group, ValueSpool()
        self._spool[1].add(result.values)

    def _unspool(self) -> None:
        if self._spool:
            group, spool = self._spool
            self._statistics.append(spool.measure(group))
            self._spool = None

    def frames(self) -> Frames:
        """Return the frames of the campaign."""
        return concatenate_frames(self._frames)

    def copies(self) -> list[Copies]:
        """Return what was left out because another trace holds it."""
        return [copies for of_key in self._copies.values() for copies in of_key]

    def summary(self, grouping: Grouping) -> Summary:
        """Return one row per group."""
        self._unspool()
        statistics = Statistics.concatenate(self._statistics)
        if self._sketch:
            statistics = merge_sketches(statistics)
        return summarize_groups(grouping, pl.concat(self._counts), statistics)
