"""Merge the results of batches: exact where they brought values, by histograms where they did not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from ..groups.frames import concatenate_frames
from ..groups.summary import Statistics, summarize_groups
from .oversized import ValueSpool, merge_sketches

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..cache.event_index import Copies, EventKey
    from ..groups.batch import Grouping
    from ..groups.frames import Frames
    from ..groups.summary import Summary
    from .batches import BatchResult


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """The results of all batches of a campaign.

    Attributes:
        summary: counts and statistics.
        frames: by name, see `groups/frames.py`.
        copies: events that were left out because another trace holds them.
    """

    summary: Summary
    frames: Frames
    copies: tuple[Copies, ...]


def merge_results(results: Iterable[BatchResult], grouping: Grouping, *, sketch: bool) -> Merged:
    """Merge the results of batches as they come.

    Args:
        results: in the order of groups; of a part of a group with its values, unless it is a sketch.
        grouping: the groups of the campaign.
        sketch: take percentiles from histograms, also of groups that were held whole.
    """
    frames: list[Frames] = []
    counts: list[pl.DataFrame] = []
    copies: dict[EventKey, tuple[Copies, ...]] = {}  # by key: T1 of a run may be in several batches
    statistics = _StatisticsInOrder()
    for result in results:
        frames.append(result.frames)
        counts.append(result.counts)
        copies |= result.copies
        statistics.add(result)
    merged = Statistics.concatenate(statistics.finish())
    return Merged(
        summary=summarize_groups(grouping, pl.concat(counts), merge_sketches(merged) if sketch else merged),
        frames=concatenate_frames(frames),
        copies=tuple(copied for of_key in copies.values() for copied in of_key),
    )


class _StatisticsInOrder:
    """Statistics of batches in the order of groups; values of a group that comes in parts are spooled."""

    def __init__(self) -> None:
        self._done: list[Statistics] = []
        self._spool: tuple[int, ValueSpool] | None = None

    def add(self, result: BatchResult) -> None:
        """Take the statistics, or the values, of the next batch."""
        group = int(result.statistics.frame["group"][0])
        if self._spool and (result.values is None or self._spool[0] != group):
            self._unspool()
        if result.values is None:
            self._done.append(result.statistics)
            return
        if self._spool is None:
            self._spool = group, ValueSpool()
        self._spool[1].add(result.values)

    def finish(self) -> list[Statistics]:
        """Return the statistics of all groups."""
        self._unspool()
        return self._done

    def _unspool(self) -> None:
        if self._spool:
            group, spool = self._spool
            self._done.append(spool.measure(group))
            self._spool = None
