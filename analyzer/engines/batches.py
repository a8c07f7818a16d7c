"""Split a campaign into batches that fit in memory; compute one batch, here or on a worker of a cluster."""

from __future__ import annotations

import hashlib
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from sys import getsizeof
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np

from dds_trace.base.threads import InlineExecutor

from ..cache.event_index import merge_parts
from ..cache.parquet_join import RowPart
from ..groups.batch import WHOLE_GROUP_EVENTS, Batch
from ..groups.frames import CAMPAIGN_MAKERS, GROUP_DETAIL_MAKERS, MAKERS, RUN_DETAIL_MAKERS, begin_frames
from ..groups.summary import Statistics, measure_batch, metric_values
from ..model.metrics import METRICS
from ..pairing.parquet import encode_rows, tables_of
from ..pairing.roundtrips import pair_exchanges

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from concurrent.futures import Executor
    from pathlib import Path

    import polars as pl
    import pyarrow as pa
    from numpy.typing import NDArray

    from ..cache.event_index import Copies, EventKey, EventPart
    from ..groups.batch import AnalysisOptions, Grouping
    from ..groups.frames import Frames
    from ..pairing.exchanges import Exchange
    from ..pairing.roundtrips import PairedRows, RoundTrips
    from .cached_details import KnownDetails

    Begun = Mapping[str, Callable[[], pl.DataFrame]]
    """Name of a frame -> waits for it."""

Rows_co = TypeVar("Rows_co", bound="PairedRows", covariant=True)

BATCH_EVENTS = 1_000_000
"""Events of a batch, unless one group alone has more: a hundred megabytes while it is worked at. Of a campaign of few
batches one is written while the next is paired; smaller ones cost more in polars' fixed times than they gain."""

BATCH_GROUPS = 250
"""Groups of a batch at most, each of which takes a millisecond however few its messages: else thousands are one core's work."""


KEPT_BLOCK_BYTES = 31 << 20
"""Largest block of memory that is kept when it is freed; glibc takes no more than 32 MB for that."""


def keep_freed_memory() -> None:
    """Let this process keep the memory of small batches, some sixty megabytes, where its C library is glibc.

    A batch asks again and again for arrays of 0.1 to 16 MB. Blocks above a threshold go back to the kernel when they are freed,
    and it clears every page of the next one: small groups take 1.6 times as long. Glibc raises that threshold to the
    largest block that was ever freed (mallopt(3), M_MMAP_THRESHOLD); pages of this one are never touched.
    """
    np.empty(KEPT_BLOCK_BYTES, np.uint8)


def plan_batches(grouping: Grouping, options: AnalysisOptions) -> list[Batch]:
    """Return batches of whole groups, in their order; a group too large for one comes in parts of whole runs.

    Some groups end their batch though it is not full, chosen by their parameters and events alone: so a new run changes few
    batches beside its own, and the details of the others are known (`cached_details.py`).
    """
    exchanges, groups = grouping.exchanges, grouping.group_of_exchange
    events_before = np.cumsum([0, *(sum(exchange.counts) for exchange in exchanges)]).tolist()

    def events(first: int, after: int) -> int:
        return int(events_before[after] - events_before[first])

    spans: list[
        tuple[int, int, bool]
    ] = []  # first exchange, the one behind the last, whether of whole groups
    parameters, is_ended, groups_held = grouping.parameters.rows(), False, 0
    edges = [0, *(np.flatnonzero(np.diff(groups)) + 1).tolist(), len(exchanges)]
    for first, after in pairwise(edges):
        if (
            events(first, after) > WHOLE_GROUP_EVENTS
            and len({e.run.run_id for e in exchanges[first:after]}) > 1
        ):
            parts = _parts_of_group(exchanges[first:after])
            spans += ((first + begin, first + end, False) for begin, end in parts)
        elif (
            spans
            and spans[-1][2]
            and events(spans[-1][0], after) <= BATCH_EVENTS
            and groups_held < BATCH_GROUPS
            and not is_ended
        ):
            spans[-1] = (spans[-1][0], after, True)
            groups_held += 1
        else:
            spans.append((first, after, True))
            groups_held = 1
        is_ended = _ends_batch(parameters[groups[first]], events(first, after))
    return [
        Batch(exchanges[first:after], groups[first:after], len(exchanges), whole, options)
        for first, after, whole in spans
    ]


def _ends_batch(parameters: tuple[object, ...], events: int) -> bool:
    """Return whether a batch ends behind this group: one in as many as fill it."""
    return _is_drawn(repr(parameters), max(events / BATCH_EVENTS, 1 / BATCH_GROUPS))


def _is_drawn(name: str, share: float) -> bool:
    """Return whether this name is of a share of all, which looks like chance and is none."""
    # No CRC: those of texts that differ in a digit lie side by side.
    digest = hashlib.blake2b(name.encode(), digest_size=4).digest()
    return int.from_bytes(digest, "big") < int(share * (1 << 32))


def _parts_of_group(exchanges: Sequence[Exchange]) -> list[tuple[int, int]]:
    """Cut exchanges into parts of whole runs (the first one, and the one behind the last); as of groups, some runs end their part."""
    count = len(exchanges)
    edges = [place for place in range(1, count) if exchanges[place].run is not exchanges[place - 1].run]
    parts: list[tuple[int, int]] = []
    held, is_ended = 0, False
    for begin, end in pairwise([0, *edges, count]):
        events = sum(sum(exchange.counts) for exchange in exchanges[begin:end])
        if parts and not is_ended and held + events <= BATCH_EVENTS:
            parts[-1] = (parts[-1][0], end)
            held += events
        else:
            parts.append((begin, end))
            held = events
        is_ended = _is_drawn(f"{exchanges[begin].run.run_id:016x}", events / BATCH_EVENTS)
    return parts


def parts_of(batch: Batch) -> list[Batch]:
    """Return a batch that is larger than one is to be in parts of whole runs, as its rows are written; any other one alone.

    The rows of a part begin a row group: so they are the same bytes whatever other runs its group has.
    """
    exchanges, groups = batch.exchanges, batch.group_of_exchange
    if batch.events <= BATCH_EVENTS:
        return [batch]
    return [
        replace(batch, exchanges=exchanges[first:after], group_of_exchange=groups[first:after], whole=False)
        for first, after in _parts_of_group(exchanges)
    ]


def groups_in_parts(batches: Sequence[Batch]) -> list[int]:
    """Return the groups that no batch holds whole, rising."""
    return sorted({int(group) for batch in batches if not batch.whole for group in batch.group_of_exchange})


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """What a batch gives beside its rows.

    Attributes:
        frames: by name, see `groups/frames.py`.
        counts: one row per exchange, columns of `counts.COUNT_SCHEMA`.
        statistics: of its groups; of a part of a group they are those of the part.
        copies: events that were left out because another trace holds them, by key.
        values: metric -> int64 values that are not null, of a part of a group; None of whole groups.
    """

    frames: Frames
    counts: pl.DataFrame
    statistics: Statistics
    copies: Mapping[EventKey, tuple[Copies, ...]]
    values: Mapping[str, NDArray[np.int64]] | None

    def __sizeof__(self) -> int:
        return object.__sizeof__(self) + sum(map(getsizeof, (self.values or {}).values()))


@dataclass(frozen=True, slots=True, eq=False)
class PairedBatch(Generic[Rows_co]):
    """A batch whose events are paired: its rows can be written while it is measured.

    Attributes:
        batch: the batch.
        parts: for each of its `event_keys` the rows of the event index, traces in rising order.
        rows: the rows.
        copies: events that were left out because another trace holds them, by key.
    """

    batch: Batch
    parts: Mapping[EventKey, Sequence[EventPart]]
    rows: Rows_co
    copies: Mapping[EventKey, tuple[Copies, ...]]


def split_rows(parts: Iterable[Batch], roundtrips: RoundTrips) -> Iterator[RoundTrips]:
    """Yield the rows of each of the parts of a batch (`parts_of`)."""
    begin = 0
    for part in parts:
        end = begin + len(part.exchanges)
        yield roundtrips.part(begin, end)
        begin = end


def tables_of_batch(batch: Batch, roundtrips: RoundTrips) -> Iterator[pa.Table]:
    """Yield the rows as `RowStore` takes them, none if they are not wanted; each table is made when it is asked for."""
    if batch.options.rows:
        for of_part in split_rows(parts_of(batch), roundtrips):
            yield from tables_of(of_part)


class WorkedBatch(NamedTuple):
    """What becomes of a batch.

    Attributes:
        rows: for `RowStore`; none if they are not wanted. Tables, or parts of the file in which they are encoded already.
        measured: all else, or who makes it meanwhile.
    """

    rows: Iterable[pa.Table] | Iterable[RowPart] | RowPart
    measured: BatchResult | Future[BatchResult]

    def encoded(self, folder: Path | None = None) -> WorkedBatch:
        """Return the same for another process: rows encoded as they will be in their file, in a folder or in memory.

        Raises:
            OutputError: the rows could not be kept.
        """
        if isinstance(self.rows, RowPart):
            return self._replace(rows=self.rows.in_folder(folder)) if folder else self
        return self._replace(rows=encode_rows(self.rows, folder)) if self.rows else self

    def result(self) -> BatchResult:
        """Return all else, waiting for who makes it."""
        return self.measured.result() if isinstance(self.measured, Future) else self.measured


def work_at(
    batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], known: KnownDetails | None = None
) -> WorkedBatch:
    """Pair and measure a batch; see `pair_at` and `measure_at`."""
    here = InlineExecutor()
    paired = pair_at(batch, parts, here)
    return WorkedBatch(list(tables_of_batch(batch, paired.rows)), measure_at(paired, known, here))


def measure_at(paired: PairedBatch[RoundTrips], known: KnownDetails | None, pool: Executor) -> BatchResult:
    """Measure a batch.

    Args:
        paired: the batch, paired.
        known: what earlier analyses have made.
        pool: makes each part.
    """
    batch, rows = paired.batch, paired.rows
    of_runs = {**MAKERS, **(RUN_DETAIL_MAKERS if batch.options.details else {})}
    begin_runs = partial(begin_frames, of_runs, batch, rows, pool)
    return measure_groups_of(
        paired, begin_frames(CAMPAIGN_MAKERS, batch, rows, pool), begin_runs, known, pool
    )


def measure_groups_of(
    paired: PairedBatch[PairedRows],
    of_campaign: Begun,
    begin_runs: Callable[[], Begun],
    known: KnownDetails | None,
    pool: Executor,
) -> BatchResult:
    """Measure a batch of which each run is measured by others.

    Args:
        paired: the batch, paired.
        of_campaign: who makes the frames of `frames.CAMPAIGN_MAKERS`.
        begin_runs: begins the other frames of runs, unless all frames of the batch are known.
        known: what earlier analyses have made.
        pool: makes each part.
    """
    batch, parts, rows = paired.batch, paired.parts, paired.rows
    options = batch.options

    def make() -> Frames:
        statistics = pool.submit(measure_batch, rows, batch.group_of_exchange)
        of_runs = begin_runs()
        of_groups = begin_frames(GROUP_DETAIL_MAKERS, batch, rows, pool) if options.details else {}
        frames = _results(of_runs) | _results(of_groups)
        measured = statistics.result()
        return {"statistics": measured.frame, "distributions": measured.distributions} | frames

    frames = known.frames_of(batch, parts, make) if known and options.details else make()
    statistics = Statistics(frames.pop("statistics"), frames.pop("distributions"))
    values = None
    if options.rows and not batch.whole:
        exchanges = len(batch.exchanges)
        values = {metric: metric_values(rows, metric, 0, exchanges) for metric in METRICS}
    return BatchResult(
        frames=_results(of_campaign) | frames,
        counts=rows.counts,
        statistics=statistics,
        copies=paired.copies,
        values=values,
    )


def _results(begun: Begun) -> Frames:
    return {name: wait() for name, wait in begun.items()}


def pair_at(
    batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], pool: Executor
) -> PairedBatch[RoundTrips]:
    """Pair the events of a batch; the memory of those that were fetched is free when this returns.

    Args:
        batch: the batch.
        parts: for each of its `event_keys` the rows of the event index, traces in rising order.
        pool: reads the events of each key, counts messages and fits clocks.
    """
    keys = batch.event_keys()
    merged = dict(zip(keys, pool.map(merge_parts, [parts.get(key, ()) for key in keys]), strict=True))
    events = {key: columns for key, (columns, _) in merged.items()}
    copies = {key: of_key for key, (_, of_key) in merged.items() if of_key}
    roundtrips = pair_exchanges(batch.exchanges, events, details=batch.options.details, pool=pool)
    return PairedBatch(batch, parts, roundtrips, copies)
