"""Engines do the work of an analysis: here the cores of this machine, in `engines/cluster.py` those of a cluster."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from functools import partial
from typing import TYPE_CHECKING, Protocol, TypeVar

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.threads import in_turn

from ..cache.store import TraceCache
from ..cache.traces import TraceShelf
from ..loading.campaign import load_campaign
from .batches import (
    BATCH_EVENTS,
    WorkedBatch,
    keep_freed_memory,
    measure_at,
    pair_at,
    tables_of_batch,
    work_at,
)
from .cached_details import KnownDetails
from .large_batches import pair_large

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
    from concurrent.futures import Future
    from pathlib import Path

    from ..cache.event_index import EventIndex, EventKey, EventPart
    from ..cache.loaded import LoadedTrace
    from ..groups.batch import Batch
    from ..loading.campaign import Campaign, Progress
    from ..loading.place import Place
    from .processes import Workers

T = TypeVar("T")
R = TypeVar("R")

_MOST_THREADS = 2  # each holds a batch; the writing of rows takes another core
_MOST_PROCESSES = 4  # each holds a trace or a batch, and 0.2 GB of libraries

FILES_FOR_PROCESSES = 300
"""Traces for which worker processes are started; fewer are read before that would pay."""

BYTES_FOR_FILES = 150_000_000
"""Size of all traces from which on their events wait in files: worker processes read them there, those of fewer come through pipes."""

COST_FOR_PROCESSES = 8_000_000
_COST_OF_GROUP = 10_000
"""Events of all batches, and what a group costs beside them, in events, for which worker processes are started: an eighth less
time at 20 M, as much at 5 M. They take half a second of a core each to start (`docs/explanation/performance.md`)."""

_MOST_EVENTS_AHEAD = 8_000_000
"""Events of batches that are worked at, or whose results wait: one that is larger is alone in memory."""

_FILES_AT_ONCE = 16
"""Traces that a worker reads before it says what it found."""


class Engine(Protocol):
    """Loads traces, then works at batches; it is closed at the end."""

    def load(self, place: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Load every trace of a place; see `load_campaign`."""

    def work(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[WorkedBatch]:
        """Yield what becomes of the batches in their order."""

    def has_workers_with(self, file: Path) -> bool:
        """Return whether there are other processes for `map`, and they find this file where it is here."""

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        """Return the function's results in the order of the items, by other processes, to which function and items are sent."""

    def close(self) -> None:
        """Release memory, files and connections."""


class LocalEngine:
    """This machine as an `Engine`: threads, and processes for a campaign that takes long.

    Args:
        cache: whether the user's cache keeps events and details for the next analysis.
    """

    def __init__(self, *, cache: bool) -> None:
        self._cache = TraceCache.open() if cache else None
        self._shelf = TraceShelf(self._cache)
        self._cores = len(os.sched_getaffinity(0))
        self._workers: Workers | None = None

    def load(self, place: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Read every trace that is not in the cache."""
        return load_campaign(place, skip=skip, progress=progress, load_all=self._load_all)

    def work(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[WorkedBatch]:
        """Yield what becomes of the batches, worked at on all cores; one batch waits in memory for its turn.

        A large one, whose arrays are long, stays here, and what follows its pairing is made side by side, while the caller
        writes its rows. Others would wait for Python's lock here: worker processes do them where they are enough to pay.
        """
        if self._workers is None and _cost_of_small(batches) >= COST_FOR_PROCESSES:
            self._workers = self._start_workers()
        if not any(map(_is_large, batches)):  # beside the arrays of a large one there is no room
            keep_freed_memory()
        known = KnownDetails(self._cache, self._shelf.keys) if self._cache else None
        count = min(_MOST_THREADS, self._cores)
        with (
            ThreadPoolExecutor(count, thread_name_prefix="analyze") as threads,
            ThreadPoolExecutor(count, thread_name_prefix="measure") as measuring,
        ):

            def work_at_large(batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]]) -> WorkedBatch:
                if known is None or not (batch.options.rows and batch.options.details):
                    paired = pair_at(batch, parts, measuring)
                    rows = tables_of_batch(batch, paired.rows)
                    return WorkedBatch(rows, threads.submit(measure_at, paired, known, measuring))
                large = pair_large(batch, parts, known, measuring)
                return WorkedBatch(large.rows(), threads.submit(large.measure))

            def begin(batch: Batch) -> Future[WorkedBatch]:
                parts = {key: index[key] for key in batch.event_keys() if key in index}
                if _is_large(batch):
                    return threads.submit(work_at_large, batch, parts)
                if self._workers is None:
                    return threads.submit(work_at, batch, parts, known)
                traces = {part.trace for held in parts.values() for part in held}
                keys = {trace: self._shelf.keys[trace] for trace in traces if trace in self._shelf.keys}
                return self._workers.work(batch, parts, keys)

            ahead = count if self._workers is None else 2 * self._workers.count
            jobs = ((batch.events, partial(begin, batch)) for batch in batches)
            with self._workers.telling() if self._workers else nullcontext():
                yield from in_turn(jobs, ahead + 1, _MOST_EVENTS_AHEAD)

    def has_workers_with(self, file: Path) -> bool:  # noqa: ARG002 - they are on this machine
        """Return whether there are worker processes by now."""
        return self._workers is not None

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        """Return the function's results in the order of the items: by the worker processes if there are any, else here."""
        return map(function, items) if self._workers is None else self._workers.map(function, items)

    @property
    def _processes(self) -> int:
        return min(_MOST_PROCESSES, self._cores)

    def _load_all(self, paths: Sequence[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        workers = self._start_workers() if len(paths) >= FILES_FOR_PROCESSES else None
        if workers is None:
            if sum(map(_bytes_of, paths)) >= BYTES_FOR_FILES:
                self._shelf.hold_no_more()
            yield from self._shelf.load_all(paths)
            return
        self._workers = workers
        jobs = (
            (0, partial(workers.store, paths[first : first + _FILES_AT_ONCE], first))
            for first in range(0, len(paths), _FILES_AT_ONCE)
        )
        position = 0
        with workers.telling():
            for stored in in_turn(jobs, 2 * workers.count + 1, most_size=0):
                for key, found in stored:
                    if isinstance(found, TraceFormatError):
                        yield found
                        continue
                    if key:
                        self._shelf.keys[position] = key
                    yield found.at(position)
                    position += 1

    def _start_workers(self) -> Workers | None:
        """Start the worker processes; None where there can be none, or one alone."""
        # A small campaign does without multiprocessing.
        from .processes import Workers, can_start_workers  # noqa: PLC0415

        if self._processes == 1 or not can_start_workers():
            return None
        return Workers(self._processes, cache=self._cache is not None)

    def close(self) -> None:
        """End the workers and remove temporary files."""
        if self._workers is not None:
            self._workers.close()
        self._shelf.close()


def _cost_of_small(batches: Sequence[Batch]) -> int:
    """Return what the batches that are not large cost, in events."""
    small = [batch for batch in batches if not _is_large(batch)]
    groups = {int(group) for batch in small for group in batch.group_of_exchange}
    return sum(batch.events for batch in small) + _COST_OF_GROUP * len(groups)


def _bytes_of(path: Path) -> int:
    """Return the size of a trace, a folder's of the files in it; 0 where it cannot be told."""
    with suppress(OSError):
        files = path.iterdir() if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files)
    return 0


def _is_large(batch: Batch) -> bool:
    """Return whether one group, or one run of a group, has more events than a batch is to have."""
    return batch.events > BATCH_EVENTS
