"""Engines do the work of an analysis: this machine here, a cluster in `cluster.py`."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.threads import in_turn

from ..cache.event_index import EventIndex
from ..cache.loaded import LoadedTrace
from ..cache.store import TraceCache
from ..cache.traces import TraceLoader
from ..groups.batch import Batch
from ..loading.campaign import Campaign, Place, Progress, load_campaign
from .batches import is_large, keep_freed_memory
from .process import BatchOutput, process
from .processes import Workers
from .result_cache import ResultCache

T = TypeVar("T")
R = TypeVar("R")

_MOST_THREADS = 2  # each has a batch in memory; another core writes the rows
_MOST_PROCESSES = 4  # each has a trace or a batch in memory, and 0.2 GB of libraries

FILES_FOR_PROCESSES = 300
"""Traces from which on worker processes pay, each half a second of a core."""

BYTES_FOR_FILES = 150_000_000
"""Size of all traces from which on their events wait in files."""

COST_FOR_PROCESSES = 8_000_000
"""Events of all batches from which on worker processes pay (`docs/explanation/performance.md`)."""

_COST_OF_GROUP = 10_000  # in events

_MOST_EVENTS_AHEAD = 8_000_000
"""Events of batches in progress, or whose results wait; a larger batch is processed on its own."""

_FILES_PER_JOB = 16


class Engine(Protocol):
    """Loads traces, then processes batches; it is closed at the end."""

    def load(self, location: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Load every trace of a location; see `load_campaign`."""

    def process(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchOutput]:
        """Yield rows and results of the batches, in their order."""

    def has_workers_with(self, file: Path) -> bool:
        """Return whether other processes for `map` see this file under this path."""

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        """Return results in order; function and items are sent to other processes."""

    def close(self) -> None:
        """Release memory, files and connections."""


class LocalEngine:
    """This machine as an `Engine`: threads, and processes for a large campaign."""

    def __init__(self, *, cache: bool) -> None:
        self._cache = TraceCache.open() if cache else None
        self._loader = TraceLoader(self._cache)
        self._cores = len(os.sched_getaffinity(0))
        self._workers: Workers | None = None

    def load(self, location: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        return load_campaign(location, skip=skip, progress=progress, load_all=self._load_all)

    def process(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchOutput]:
        """Yield rows and results of the batches, processed on all cores; one batch waits in memory for its turn.

        Threads process a large batch, and measure it while the caller writes its rows. Where worker processes pay they
        take small batches, which would wait for Python's lock here.
        """
        if self._workers is None and _cost_of_small(batches) >= COST_FOR_PROCESSES:
            self._workers = self._start_workers()
        if not any(map(is_large, batches)):  # a large one leaves no room
            keep_freed_memory()
        cache = ResultCache(self._cache, self._loader.keys) if self._cache else None
        count = min(_MOST_THREADS, self._cores)
        with (
            ThreadPoolExecutor(count, thread_name_prefix="analyze") as threads,
            ThreadPoolExecutor(count, thread_name_prefix="measure") as measuring,
        ):

            def begin(batch: Batch) -> Future[BatchOutput]:
                parts = {key: index[key] for key in batch.event_keys() if key in index}
                if is_large(batch):
                    return threads.submit(process, batch, parts, cache, measuring, threads)
                if self._workers is None:
                    return threads.submit(process, batch, parts, cache)
                traces = {part.trace for parts_of_key in parts.values() for part in parts_of_key}
                keys = {trace: self._loader.keys[trace] for trace in traces if trace in self._loader.keys}
                return self._workers.process(batch, parts, keys)

            ahead = count if self._workers is None else 2 * self._workers.count
            jobs = ((batch.events, partial(begin, batch)) for batch in batches)
            with self._workers.explaining_kills() if self._workers else nullcontext():
                yield from in_turn(jobs, ahead + 1, _MOST_EVENTS_AHEAD)

    def has_workers_with(self, file: Path) -> bool:  # noqa: ARG002 - they are on this machine
        return self._workers is not None

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        return map(function, items) if self._workers is None else self._workers.map(function, items)

    def close(self) -> None:
        if self._workers is not None:
            self._workers.close()
        self._loader.close()

    @property
    def _processes(self) -> int:
        return min(_MOST_PROCESSES, self._cores)

    def _load_all(self, paths: Sequence[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        workers = self._start_workers() if len(paths) >= FILES_FOR_PROCESSES else None
        if workers is None:
            if sum(map(_bytes_of, paths)) >= BYTES_FOR_FILES:
                self._loader.use_files()
            yield from self._loader.load_all(paths)
            return
        self._workers = workers
        jobs = (
            (0, partial(workers.store, paths[first : first + _FILES_PER_JOB], first))
            for first in range(0, len(paths), _FILES_PER_JOB)
        )
        position = 0
        with workers.explaining_kills():
            for stored in in_turn(jobs, 2 * workers.count + 1, most_size=0):
                for key, trace in stored:
                    if isinstance(trace, TraceFormatError):
                        yield trace
                        continue
                    if key:
                        self._loader.keys[position] = key
                    yield trace.at(position)
                    position += 1

    def _start_workers(self) -> Workers | None:
        # A small campaign does without multiprocessing.
        from .processes import Workers, can_start_workers  # noqa: PLC0415

        if self._processes == 1 or not can_start_workers():
            return None
        return Workers(self._processes, cache=self._cache is not None)


def _cost_of_small(batches: Sequence[Batch]) -> int:
    small = [batch for batch in batches if not is_large(batch)]
    groups = {int(group) for batch in small for group in batch.group_of_exchange}
    return sum(batch.events for batch in small) + _COST_OF_GROUP * len(groups)


def _bytes_of(path: Path) -> int:
    with suppress(OSError):
        files = path.iterdir() if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files)
    return 0
