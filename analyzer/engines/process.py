"""Pair and measure a batch: cached results are neither read nor computed again.

A large batch is processed in parts of whole runs (`batches.parts_of`), so that only the new run of a large group is paired.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, wait
from dataclasses import dataclass
from functools import partial
from sys import getsizeof
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.base.threads import InlineExecutor

from ..cache.event_index import Copies, EventKey, EventPart, merge_parts
from ..groups.frames import (
    CAMPAIGN_MAKERS,
    GROUP_DETAIL_MAKERS,
    MAKERS,
    RUN_DETAIL_MAKERS,
    Frames,
    begin_frames,
    concatenate_frames,
)
from ..groups.summary import Statistics, measure_batch, metric_values
from ..groups.timeline import points_of_exchange
from ..model.metrics import METRICS
from ..pairing.parquet import tables_of
from ..pairing.roundtrips import PairedRows, RoundTrips, bounds_of, describe, pair_exchanges
from .batches import parts_of
from .packed_rows import PackedRows, packed

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa
    from numpy.typing import NDArray

    from ..groups.batch import Batch
    from .result_cache import ResultCache


Parts = Mapping[EventKey, Sequence[EventPart]]
"""For each of a batch's `event_keys` the rows of the event index, traces in ascending order."""
CopiesByKey = Mapping[EventKey, tuple[Copies, ...]]


_GROUP_FRAMES = {"statistics", "distributions", *GROUP_DETAIL_MAKERS}
_RUN_MAKERS = {**CAMPAIGN_MAKERS, **MAKERS}
_RUN_DETAIL_MAKERS = {**_RUN_MAKERS, **RUN_DETAIL_MAKERS}


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """What a batch gives in addition to its rows.

    Attributes:
        counts: one row per exchange, columns of `counts.COUNT_SCHEMA`.
        copies: events that were left out because another trace has them.
        values: metric -> int64 values that are not null, for a part of a group; None for whole groups.
    """

    frames: Frames
    counts: pl.DataFrame
    statistics: Statistics
    copies: CopiesByKey
    values: Mapping[str, NDArray[np.int64]] | None

    def __sizeof__(self) -> int:
        return object.__sizeof__(self) + sum(map(getsizeof, (self.values or {}).values()))


@dataclass(frozen=True, slots=True, eq=False)
class BatchOutput:
    """The rows of a batch, part by part, if requested, and its result.

    Attributes:
        stored: the cached rows of each part, None where they could not be written.
    """

    rows: Sequence[RoundTrips | PackedRows]
    measured: BatchResult | Future[BatchResult]
    stored: Sequence[Future[PackedRows | None]] = ()

    def tables(self) -> Iterator[pa.Table]:
        for rows in self.rows:
            yield from tables_of(rows)
            if isinstance(rows, PackedRows):
                rows.remove()

    def result(self) -> BatchResult:
        wait(self.stored)
        return self.measured.result() if isinstance(self.measured, Future) else self.measured

    def packed(self, folder: Path | None) -> BatchOutput:
        """Return the same for another process: rows that are not cached in files of `folder`, None for in memory.

        Raises:
            OutputError: the rows cannot be written.
        """
        in_cache = [future.result() for future in self.stored] or [None] * len(self.rows)
        rows = [there or packed(rows, folder) for there, rows in zip(in_cache, self.rows, strict=True)]
        return BatchOutput(rows, self.result())


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Some runs of a batch; `key` is None where it must not be cached; `rows` are in memory unless all was cached."""

    batch: Batch
    key: str | None
    cached: PackedRows | None
    run_frames: Frames | None
    rows: RoundTrips | PackedRows


@dataclass(frozen=True, slots=True, eq=False)
class _JoinedRows(PairedRows):
    """The rows of several parts, joined column by column."""

    parts: Sequence[PairedRows]

    @classmethod
    def of(cls, batch: Batch, parts: Sequence[PairedRows]) -> _JoinedRows:
        counts = pl.concat([part.counts for part in parts])
        first_exchanges = np.cumsum([0, *(len(part.counts) for part in parts)]).tolist()
        knots = [
            part.clock_knots.with_columns(pl.col("group") + first)
            for part, first in zip(parts, first_exchanges, strict=False)
        ]
        return cls(describe(batch.exchanges), bounds_of(counts), counts, pl.concat(knots), parts)

    @property
    def stamp_names(self) -> frozenset[str]:
        return frozenset[str]().union(*(part.stamp_names for part in self.parts))

    def column(self, name: str) -> pl.Series:
        is_stamp = name in self.stamp_names
        columns = [
            part.column(name)
            if not is_stamp or name in part.stamp_names
            else pl.Series(name, np.zeros(int(part.bounds[-1]), np.int64))
            for part in self.parts
        ]
        joined: pl.Series = pl.concat(columns).rechunk()
        return joined

    def frames(self) -> Iterator[pl.DataFrame]:
        for part in self.parts:
            yield from part.frames()


def process(
    batch: Batch,
    parts: Parts,
    cache: ResultCache | None = None,
    pool: Executor | None = None,
    threads: Executor | None = None,
) -> BatchOutput:
    """Pair and measure a batch.

    `pool` does what can be done in parallel; `threads` measure while the caller writes the rows. Without, all is done here.
    """
    pool, threads = pool or InlineExecutor(), threads or InlineExecutor()
    cache = cache if batch.options.details else None
    runs, rows, copies = _pair(batch, parts, cache, pool)
    stored = [pool.submit(_store, part, cache) for part in runs] if cache and batch.options.rows else []
    measured = threads.submit(_measure, batch, parts, runs, rows, copies, cache, pool)
    return BatchOutput([part.rows for part in runs] if batch.options.rows else [], measured, stored)


def _pair(
    batch: Batch, parts: Parts, cache: ResultCache | None, pool: Executor
) -> tuple[list[_Part], PairedRows, CopiesByKey]:
    batches = parts_of(batch) if batch.options.rows else [batch]
    keys = [cache.key_of(runs, parts) if cache else None for runs in batches]
    cached = [
        cache.read_rows(key, runs) if cache and key and batch.options.rows else None
        for key, runs in zip(keys, batches, strict=True)
    ]
    frames = [_cached_run_frames(runs, key, cache) for key, runs in zip(keys, batches, strict=True)]
    copies: dict[EventKey, tuple[Copies, ...]] = {}
    rows: list[RoundTrips | PackedRows] = []
    if any(cached):
        for runs, packed_rows, run_frames in zip(batches, cached, frames, strict=True):
            if packed_rows is None:
                rows.append(_pair_events(runs, parts, pool, copies))
            else:
                rows.append(packed_rows if run_frames is not None else packed_rows.load())
        whole: PairedRows = rows[0] if len(rows) == 1 else _JoinedRows.of(batch, rows)
    else:  # all at once, into the same memory
        whole = paired = _pair_events(batch, parts, pool, copies)
        rows += _split(batches, paired)
    # Names of traces, which are not part of the key, decide which of two has the copy.
    has_copies = [any(key in copies for key in runs.event_keys()) for runs in batches]
    keys = [None if copied else key for key, copied in zip(keys, has_copies, strict=True)]
    return [_Part(*part) for part in zip(batches, keys, cached, frames, rows, strict=True)], whole, copies


def _cached_run_frames(batch: Batch, key: str | None, cache: ResultCache | None) -> Frames | None:
    if cache is None or key is None:
        return None
    return cache.read_frames(_run_key(batch, key), _RUN_DETAIL_MAKERS.keys(), batch.first_group)


def _run_key(batch: Batch, key: str) -> str:
    return f"{key} {points_of_exchange(batch.all_exchanges)}"


def _split(batches: Sequence[Batch], rows: RoundTrips) -> Iterator[RoundTrips]:
    if len(batches) == 1:
        yield rows
        return
    first = 0
    for batch in batches:
        yield rows.part(first, first + len(batch.exchanges))
        first += len(batch.exchanges)


def _pair_events(batch: Batch, parts: Parts, pool: Executor, copies: dict[EventKey, tuple[Copies, ...]]) -> RoundTrips:
    """Add the copies to `copies`; fetched events are free on return."""
    keys = batch.event_keys()
    merged = dict(zip(keys, pool.map(merge_parts, [parts.get(key, ()) for key in keys]), strict=True))
    copies |= {key: copied for key, (_, copied) in merged.items() if copied}
    events = {key: columns for key, (columns, _) in merged.items()}
    return pair_exchanges(batch.exchanges, events, details=batch.options.details, pool=pool)


def _store(part: _Part, cache: ResultCache) -> PackedRows | None:
    if part.cached is not None or part.key is None or isinstance(part.rows, PackedRows):
        return part.cached
    return cache.write_rows(part.key, part.rows)


def _measure(
    batch: Batch,
    parts: Parts,
    runs: Sequence[_Part],
    rows: PairedRows,
    copies: CopiesByKey,
    cache: ResultCache | None,
    pool: Executor,
) -> BatchResult:
    has_details = batch.options.details
    key = cache.key_of(batch, parts) if cache else None
    group_frames = cache.read_frames(key, _GROUP_FRAMES, batch.first_group) if cache and key else None
    measuring = None if group_frames else pool.submit(measure_batch, rows, batch.group_of_exchange)
    run_frames = [_begin_run_frames(part, cache, pool) for part in runs]
    if measuring is not None:
        begun = begin_frames(GROUP_DETAIL_MAKERS, batch, rows, pool) if has_details else {}
        measured = measuring.result()
        group_frames = {"statistics": measured.frame, "distributions": measured.distributions}
        group_frames |= {name: result() for name, result in begun.items()}
        if cache and key:
            cache.write_frames(key, group_frames, batch.first_group)
    assert group_frames is not None
    frames = concatenate_frames([finish() for finish in run_frames])
    statistics = Statistics(group_frames.pop("statistics"), group_frames.pop("distributions"))
    values = None
    if batch.options.rows and not batch.whole:
        values = {metric: metric_values(rows, metric, 0, len(batch.exchanges)) for metric in METRICS}
    return BatchResult(frames | group_frames, rows.counts, statistics, copies, values)


def _begin_run_frames(part: _Part, cache: ResultCache | None, pool: Executor) -> Callable[[], Frames]:
    if isinstance(part.rows, PackedRows) or part.run_frames is not None:
        return partial(dict, part.run_frames or {})
    batch, key = part.batch, part.key
    makers = _RUN_DETAIL_MAKERS if batch.options.details else _RUN_MAKERS
    begun = begin_frames(makers, batch, part.rows, pool)

    def finish() -> Frames:
        frames = {name: result() for name, result in begun.items()}
        if cache is not None and key is not None:
            cache.write_frames(_run_key(batch, key), frames, batch.first_group)
        return frames

    return finish
