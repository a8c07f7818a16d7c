"""Large batches: paired and measured side by side while their rows are written, but for the parts that are known.

A part is some whole runs (`batches.parts_of`). Of a part that is known (`cached_parts.py`) nothing is paired, fitted or encoded, and
only one column at a time is in memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..groups.frames import CAMPAIGN_MAKERS, MAKERS, RUN_DETAIL_MAKERS, begin_frames, concatenate_frames
from ..groups.timeline import points_of_exchange
from ..pairing.roundtrips import PairedRows, RoundTrips, describe
from .batches import PairedBatch, measure_groups_of, pair_at, parts_of, split_rows
from .cached_parts import KnownPart, keep_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from concurrent.futures import Executor

    import pyarrow as pa

    from ..cache.event_index import Copies, EventKey, EventPart
    from ..cache.parquet_join import RowPart
    from ..groups.batch import Batch
    from ..groups.frames import Frames
    from .batches import BatchResult
    from .cached_details import KnownDetails

_MAKERS_OF_RUNS = {**CAMPAIGN_MAKERS, **MAKERS, **RUN_DETAIL_MAKERS}


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Some runs of a large batch.

    Attributes:
        batch: its exchanges.
        key: what it is known by; None where it must not be kept.
        rows: its rows.
    """

    batch: Batch
    key: str | None
    rows: RoundTrips | KnownPart

    def load(self) -> RoundTrips:
        """Return its rows in memory."""
        return self.rows.load(self.batch) if isinstance(self.rows, KnownPart) else self.rows


@dataclass(frozen=True, slots=True, eq=False)
class _RowsOfParts(PairedRows):
    """The rows of all parts, a column of them in memory when it is asked for."""

    parts: Sequence[_Part]

    @property
    def stamp_names(self) -> frozenset[str]:
        """Those that any part has."""
        return frozenset[str]().union(*(part.rows.stamp_names for part in self.parts))

    def column(self, name: str) -> pl.Series:
        """Return a column; of a stamp zero in a part whose events have none."""
        is_stamp = name in self.stamp_names
        pieces = [
            part.rows.column(name)
            if not is_stamp or name in part.rows.stamp_names
            else pl.Series(name, np.zeros(int(part.rows.counts["published"].sum()), np.int64))
            for part in self.parts
        ]
        joined: pl.Series = pl.concat(pieces).rechunk()
        return joined


class LargeBatch:
    """A large batch, paired.

    Args:
        paired: the batch.
        parts: its parts.
        known: what earlier analyses have made, and takes what this one makes.
        pool: makes what can be made side by side.
    """

    def __init__(
        self, paired: PairedBatch[PairedRows], parts: Sequence[_Part], known: KnownDetails, pool: Executor
    ) -> None:
        self._paired = paired
        self._parts = parts
        self._known = known
        self._pool = pool

    def rows(self) -> Iterable[pa.Table] | Iterable[RowPart]:
        """Return the rows as `RowStore` takes them; each table of a new part is made, and kept, when it is asked for."""
        known, pool = self._known, self._pool
        return (
            rows
            for part in self._parts
            for rows in (
                part.rows.rows
                if isinstance(part.rows, KnownPart)
                else keep_rows(part.key, known, part.rows, pool)
            )
        )

    def measure(self) -> BatchResult:
        """Measure the batch; what is told of each run alone is not made again of a part that is known."""
        waiting = [_begin_runs_of(part, self._known, self._pool) for part in self._parts]
        frames = cache(lambda: concatenate_frames([wait() for wait in waiting]))
        begun = {name: partial(_frame_named, frames, name) for name in _MAKERS_OF_RUNS}
        of_campaign = {name: begun.pop(name) for name in CAMPAIGN_MAKERS}
        return measure_groups_of(self._paired, of_campaign, partial(dict, begun), self._known, self._pool)


def _frame_named(frames: Callable[[], Frames], name: str) -> pl.DataFrame:
    return frames()[name]


def pair_large(
    batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], known: KnownDetails, pool: Executor
) -> LargeBatch:
    """Pair the events of a large batch whose rows and details are wanted, but for the parts of it that are known.

    Args:
        batch: the batch.
        parts: for each of its `event_keys` the rows of the event index, traces in rising order.
        known: what earlier analyses have made.
        pool: does all that can be done side by side.
    """
    cut = parts_of(batch)
    keys = [known.key_of_text("part", known.key_of(part, parts)) for part in cut]
    found = [KnownPart.find(key, known, pool) for key in keys]
    rows: list[RoundTrips | KnownPart] = []
    copies: dict[EventKey, tuple[Copies, ...]] = {}
    joined: RoundTrips | None = None
    if any(found):
        for part, of_part in zip(cut, found, strict=True):
            if of_part is None:
                new = pair_at(part, parts, pool)
                copies |= new.copies
            rows.append(of_part or new.rows)
    else:  # all at once, into the same memory
        paired = pair_at(batch, parts, pool)
        joined, copies = paired.rows, dict(paired.copies)
        rows += split_rows(cut, joined)
    of_parts = [
        # Which of two traces holds a copy follows from their names, which what is known would not say.
        _Part(part, None if any(held in copies for held in part.event_keys()) else key, of_part)
        for part, key, of_part in zip(cut, keys, rows, strict=True)
    ]
    held = joined or _rows_of_parts(batch, of_parts)
    return LargeBatch(PairedBatch(batch, parts, held, copies), of_parts, known, pool)


def _rows_of_parts(batch: Batch, parts: Sequence[_Part]) -> _RowsOfParts:
    """Return the rows of a batch from those of its parts."""
    counts = pl.concat([part.rows.counts for part in parts])
    exchanges_before = np.cumsum([0, *(len(part.batch.exchanges) for part in parts)]).tolist()
    return _RowsOfParts(
        described=describe(batch.exchanges),
        bounds=np.concatenate([[0], np.cumsum(counts["published"].to_numpy())]).astype(np.int64),
        counts=counts,
        clock_knots=pl.concat(
            part.rows.clock_knots.with_columns(pl.col("group") + before)
            for part, before in zip(parts, exchanges_before, strict=False)
        ),
        parts=parts,
    )


def _begin_runs_of(part: _Part, known: KnownDetails, pool: Executor) -> Callable[[], Frames]:
    """Begin the frames of runs of a part, unless they are known; the result waits for them, and keeps new ones."""
    first_group = part.batch.first_group
    points = points_of_exchange(part.batch.all_exchanges)
    key = None if part.key is None else known.key_of_text("runs", f"{part.key} {points}")
    found = None if key is None else known.find(key, first_group, _MAKERS_OF_RUNS.keys())
    if found is not None:
        return partial(dict, found)
    begun = begin_frames(_MAKERS_OF_RUNS, part.batch, part.load(), pool)

    def wait() -> Frames:
        frames = {name: wait_for() for name, wait_for in begun.items()}
        if key is not None:
            known.keep(key, first_group, frames)
        return frames

    return wait
