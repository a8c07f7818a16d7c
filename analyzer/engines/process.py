"""Pair and measure a batch, here or in another process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base.threads import InlineExecutor

from ..groups.frames import CAMPAIGN_MAKERS, DETAIL_MAKERS, MAKERS, Frames, begin_frames, concatenate_frames
from ..groups.summary import Statistics, measure_batch, metric_values
from ..loading.event_index import Copies, EventKey, EventPart, merge_parts
from ..model.metrics import METRICS
from ..pairing.parquet import tables_of
from ..pairing.roundtrips import RoundTrips, pair_exchanges

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import numpy as np
    import polars as pl
    import pyarrow as pa
    from numpy.typing import NDArray

    from ..groups.batch import Batch


Parts = Mapping[EventKey, Sequence[EventPart]]
"""For each of a batch's `event_keys` the rows of the event index, traces in ascending order."""
CopiesByKey = Mapping[EventKey, tuple[Copies, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """What a batch gives in addition to its rows.

    Attributes:
        copies: events that were left out because another trace has them.
        values: metric -> int64 values that are not null, for a part of a group; None for whole groups.
    """

    frames: Frames
    counts: pl.DataFrame
    statistics: Statistics
    copies: CopiesByKey
    values: Mapping[str, NDArray[np.int64]] | None


@dataclass(frozen=True, slots=True, eq=False)
class BatchOutput:
    """The rows of a batch, None of a sketch, and a function that waits for its result."""

    rows: RoundTrips | None
    result: Callable[[], BatchResult]

    def tables(self) -> Iterator[pa.Table]:
        return iter(()) if self.rows is None else tables_of(self.rows)


def process(batch: Batch, parts: Parts, pool: Executor | None = None) -> BatchOutput:
    """Pair a batch, and begin to measure it in the pool; without one, all is done on return."""
    pool, options = pool or InlineExecutor(), batch.options
    rows, copies = _pair_events(batch, parts, pool)
    measuring = pool.submit(measure_batch, rows, batch.group_of_exchange)
    makers = {**CAMPAIGN_MAKERS, **MAKERS, **(DETAIL_MAKERS if options.details else {})}
    begun = begin_frames(makers, batch, rows, pool)
    values = None
    if options.rows and not batch.whole:
        values = {metric: metric_values(rows, metric, 0, len(batch.exchanges)) for metric in METRICS}

    def result() -> BatchResult:
        frames = concatenate_frames([{name: frame() for name, frame in begun.items()}])
        return BatchResult(frames, rows.counts, measuring.result(), copies, values)

    return BatchOutput(rows if options.rows else None, result)


def process_elsewhere(batch: Batch, parts: Parts) -> BatchOutput:
    """Pair and measure a batch for another process."""
    output = process(batch, parts)
    return BatchOutput(output.rows, _Done(output.result()))


@dataclass(frozen=True, slots=True, eq=False)
class _Done:
    value: BatchResult

    def __call__(self) -> BatchResult:
        return self.value


def _pair_events(batch: Batch, parts: Parts, pool: Executor) -> tuple[RoundTrips, CopiesByKey]:
    keys = batch.event_keys()
    merged = dict(zip(keys, pool.map(merge_parts, [parts.get(key, ()) for key in keys]), strict=True))
    events = {key: columns for key, (columns, _) in merged.items()}
    copies = {key: copied for key, (_, copied) in merged.items() if copied}
    return pair_exchanges(batch.exchanges, events, details=batch.options.details, pool=pool), copies
