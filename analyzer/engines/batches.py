"""Split a campaign into batches that fit in memory; pair and measure a batch, here or in another process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dds_trace.tracefile.format.events import EventColumns

from ..groups.batch import WHOLE_GROUP_EVENTS, AnalysisOptions, Batch, Grouping
from ..groups.frames import DETAIL_MAKERS, MAKERS, Frames, concatenate_frames
from ..groups.intervals import measure_whole
from ..groups.summary import Statistics, measure_batch, metric_values
from ..loading.event_index import Copies, EventKey, EventPart, merge_parts
from ..model.metrics import METRICS
from ..pairing.exchanges import Exchange
from ..pairing.parquet import tables_of
from ..pairing.roundtrips import RoundTrips, pair_exchanges

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa


BATCH_EVENTS = 1_000_000
"""Events of a batch, unless one group has more: a hundred megabytes. Smaller ones lose to polars' fixed times."""

BATCH_GROUPS = 250
"""Most groups of a batch: each costs a millisecond, and thousands would be the work of one core."""

REUSED_BLOCK_BYTES = 31 << 20
"""Largest freed block of memory that is reused; glibc allows 32 MB."""


def keep_freed_memory() -> None:
    """Let this process reuse the memory of small batches where its C library is glibc.

    Freed blocks above a threshold go back to the kernel, which clears every page of the next one. Glibc raises the
    threshold to the largest block ever freed (mallopt(3), M_MMAP_THRESHOLD).
    """
    np.empty(REUSED_BLOCK_BYTES, np.uint8)


def plan_batches(grouping: Grouping, options: AnalysisOptions) -> list[Batch]:
    """Return batches of whole groups, in their order; a group too large for one comes in parts of whole runs."""
    exchanges, groups = grouping.exchanges, grouping.group_of_exchange
    if not exchanges:  # only taps recorded: frames without rows have their columns
        return [Batch((), groups, 0, whole=True, options=options)]
    events_before = np.cumsum([0, *(sum(exchange.counts) for exchange in exchanges)]).tolist()
    spans: list[tuple[int, int, bool]] = []  # first exchange, exchange after the last, whether of whole groups
    groups_in_batch = 0
    offsets = [0, *(np.flatnonzero(np.diff(groups)) + 1).tolist(), len(exchanges)]
    for first, after in pairwise(offsets):
        runs = {exchange.run.run_id for exchange in exchanges[first:after]}
        if events_before[after] - events_before[first] > WHOLE_GROUP_EVENTS and len(runs) > 1:
            parts = _parts_of_group(exchanges[first:after])
            spans += ((first + start, first + stop, False) for start, stop in parts)
            continue
        start, _, is_whole = spans[-1] if spans else (0, 0, False)
        if is_whole and events_before[after] - events_before[start] <= BATCH_EVENTS and groups_in_batch < BATCH_GROUPS:
            spans[-1] = (start, after, True)
            groups_in_batch += 1
        else:
            spans.append((first, after, True))
            groups_in_batch = 1
    return [
        Batch(exchanges[first:after], groups[first:after], len(exchanges), whole, options)
        for first, after, whole in spans
    ]


def _parts_of_group(exchanges: Sequence[Exchange]) -> list[tuple[int, int]]:
    count = len(exchanges)
    starts = [i for i in range(1, count) if exchanges[i].run is not exchanges[i - 1].run]
    parts: list[tuple[int, int]] = []
    events_of_part = 0
    for start, stop in pairwise([0, *starts, count]):
        events = sum(sum(exchange.counts) for exchange in exchanges[start:stop])
        if parts and events_of_part + events <= BATCH_EVENTS:
            parts[-1] = (parts[-1][0], stop)
            events_of_part += events
        else:
            parts.append((start, stop))
            events_of_part = events
    return parts


def is_large(batch: Batch) -> bool:
    return batch.events > BATCH_EVENTS


def groups_in_parts(batches: Sequence[Batch]) -> list[int]:
    return sorted({int(group) for batch in batches if not batch.whole for group in batch.group_of_exchange})


Parts = Mapping[EventKey, Sequence[EventPart]]
"""For each of a batch's `event_keys` the rows of the event index, traces in ascending order."""
CopiesByKey = Mapping[EventKey, tuple[Copies, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """What a batch gives besides rows: `copies` of events left out, and of a part of a group the `values` by metric."""

    frames: Frames
    counts: pl.DataFrame
    statistics: Statistics
    copies: CopiesByKey
    values: Mapping[str, NDArray[np.int64]] | None


@dataclass(frozen=True, slots=True, eq=False)
class BatchOutput:
    """The rows of a batch, None of a sketch, and its result."""

    rows: RoundTrips | None
    result: BatchResult

    def tables(self) -> Iterator[pa.Table]:
        return iter(()) if self.rows is None else tables_of(self.rows)


def process(batch: Batch, parts: Parts) -> BatchOutput:
    """Pair a batch and measure it, before its rows are written: both take hundreds of megabytes of a long run."""
    options, keys = batch.options, batch.event_keys()
    merged = {key: merge_parts(parts.get(key, ())) for key in keys}
    copies = {key: copied for key, (_, copied) in merged.items() if copied}
    events = {key: columns for key, (columns, _) in merged.items()}
    del merged
    if is_large(batch):
        _share_sequences(batch, events)
    rows = pair_exchanges(batch.exchanges, events, details=options.details)
    del events  # gigabytes of a long run
    frames: Frames = {}
    if options.details:
        statistics, frames["intervals"], frames["one_way"] = measure_whole(batch, rows)
    if not (options.details and batch.whole):
        statistics = measure_batch(rows, batch.group_of_exchange)
    makers = {**MAKERS, **(DETAIL_MAKERS if options.details else {})}
    frames |= {name: make(batch, rows) for name, make in makers.items()}
    values = None
    if options.rows and not batch.whole:
        values = {metric: metric_values(rows, metric, 0, len(batch.exchanges)) for metric in METRICS}
    result = BatchResult(concatenate_frames([frames]), rows.counts, statistics, copies, values)
    return BatchOutput(rows if options.rows else None, result)


def _share_sequences(batch: Batch, events: dict[EventKey, EventColumns]) -> None:
    for sent, *others in (exchange.event_keys() for exchange in batch.exchanges):
        for key in others:
            if np.array_equal(events[key].sequence, events[sent].sequence):
                events[key] = replace(events[key], sequence=events[sent].sequence)
