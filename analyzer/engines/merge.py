"""The results of all batches put together: exact where values came along, by histograms where they did not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from ..groups.frames import concatenate_frames
from ..groups.summary import Statistics, summarize_groups
from ..loading.events import merge_parts, total_copies
from ..pairing.roundtrips import PairedExchanges
from .oversized import ValueSpool, merge_sketches

if TYPE_CHECKING:
    from ..groups.frames import Frames
    from ..groups.summary import Grouping, Summary
    from ..loading.events import Copies, EventsByKey, StageKey
    from .batches import Worked


class MergedResults:
    """Takes the results of batches in the order of groups.

    Args:
        sketch: take percentiles from histograms, also of groups that were held whole.
    """

    def __init__(self, *, sketch: bool) -> None:
        self._sketch = sketch
        self._paired: list[PairedExchanges] = []
        self._frames: list[Frames] = []
        self._of_exchange: list[pl.DataFrame] = []
        self._statistics: list[Statistics] = []
        self._copies: dict[StageKey, tuple[Copies, ...]] = {}
        self._spool: tuple[int, ValueSpool] | None = None
        self.rows = 0

    def add(self, worked: Worked) -> None:
        """Take the next batch."""
        self.rows += worked.rows
        self._paired.append(worked.paired)
        self._frames.append(worked.frames)
        self._of_exchange.append(worked.of_exchange)
        self._copies |= worked.copies
        group = int(worked.statistics.frame["group"][0])
        if self._spool and (worked.values is None or self._spool[0] != group):
            self._unspool()
        if worked.values is None:
            self._statistics.append(worked.statistics)
            return
        if self._spool is None:
            self._spool = group, ValueSpool()
        self._spool[1].add(worked.values)

    def _unspool(self) -> None:
        if self._spool:
            group, spool = self._spool
            self._statistics.append(spool.measure(group))
            self._spool = None

    def paired(self) -> PairedExchanges:
        """All exchanges."""
        return PairedExchanges.concatenate(self._paired)

    def frames(self) -> Frames:
        """All frames."""
        return concatenate_frames(self._frames)

    def copies(self, events: EventsByKey) -> tuple[Copies, ...]:
        """What was left out because another trace holds it, in rows or in what has no row."""
        found = dict(self._copies)
        placed = {
            key for part in self._paired for exchange in part.exchanges for key in exchange.event_keys()
        }
        found |= {key: merge_parts(parts)[1] for key, parts in events.in_several() if key not in placed}
        return total_copies(copies for of_key in found.values() for copies in of_key)

    def summary(self, grouping: Grouping) -> Summary:
        """One row per group."""
        self._unspool()
        statistics = Statistics.concatenate(self._statistics)
        if self._sketch:
            statistics = merge_sketches(statistics)
        return summarize_groups(grouping, self.paired().exchanges, pl.concat(self._of_exchange), statistics)
