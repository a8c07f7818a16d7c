"""Engines do the work of an analysis: here the cores of this machine, in `engines/cluster.py` those of a cluster."""

from __future__ import annotations

import os
import tempfile
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from dds_trace.tracefile import TraceError, TraceFormatError

from ..loading.cache import TraceCache
from ..loading.campaign import load_campaign
from ..loading.remote import is_remote
from ..loading.shelf import TraceShelf
from .batches import BATCH_EVENTS, work_at
from .known_details import KnownDetails
from .processes import start_workers, store_traces, work_in_worker

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from concurrent.futures import Future, ProcessPoolExecutor

    from ..groups.batch import Batch
    from ..loading.campaign import Campaign, Progress
    from ..loading.events import EventIndex
    from ..loading.place import Place
    from ..loading.shelf import LoadedTrace
    from .batches import BatchResult

T = TypeVar("T")

_MOST_WORKERS = 2  # each holds a trace or a batch; the writing of rows takes another core

_FILES_FOR_PROCESSES = 400
_BYTES_FOR_PROCESSES = 64 << 20
"""Traces, or bytes of them, for which worker processes are started: less is done before they would have begun."""

_FILES_AT_ONCE = 16
"""Most traces that a worker reads before it says what it found."""


class Engine(Protocol):
    """Loads traces, then works at batches; it is closed at the end."""

    def load(self, place: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Load every trace of a place; see `load_campaign`."""

    def work(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchResult]:
        """Yield the results of the batches in their order."""

    def close(self) -> None:
        """Release memory, files and connections."""


class LocalEngine:
    """This machine as an `Engine`: by threads, a large campaign by processes.

    Args:
        cache: whether the user's cache keeps events and details for the next analysis.
    """

    def __init__(self, *, cache: bool) -> None:
        self._cache = TraceCache.open() if cache else None
        self._shelf = TraceShelf(self._cache)
        self._count = min(_MOST_WORKERS, len(os.sched_getaffinity(0)))
        self._workers: ProcessPoolExecutor | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def load(self, place: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        """Read every trace that is not in the cache."""
        return load_campaign(place, skip=skip, progress=progress, load_all=self._load_all)

    def work(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchResult]:
        """Yield the results of the batches, worked at on all cores; one batch waits in memory for its turn.

        A large one, whose arrays are long, stays here, and what follows its pairing is made side by side: others wait for Python's lock.
        """
        known = KnownDetails(self._cache, self._shelf.keys) if self._cache else None
        with (
            ThreadPoolExecutor(self._count, thread_name_prefix="analyze") as threads,
            ThreadPoolExecutor(self._count, thread_name_prefix="measure") as measuring,
        ):

            def submit(batch: Batch) -> Future[BatchResult]:
                parts = {key: index[key] for key in batch.event_keys() if key in index}
                if _is_large(batch):
                    return threads.submit(work_at, batch, parts, known, measuring)
                if self._workers is None:
                    return threads.submit(work_at, batch, parts, known)
                traces = {part.trace for held in parts.values() for part in held}
                keys = {trace: self._shelf.keys[trace] for trace in traces if trace in self._shelf.keys}
                return self._workers.submit(work_in_worker, batch, parts, keys)

            yield from _in_turn(map(submit, batches), self._count)

    def _load_all(self, paths: Sequence[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        if self._count == 1 or not _is_long(paths):
            yield from self._shelf.load_all(paths)
            return
        self._folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")
        self._workers = workers = start_workers(
            self._count, Path(self._folder.name), cache=self._cache is not None
        )
        at_once = min(_FILES_AT_ONCE, -(-len(paths) // self._count))
        jobs = (
            workers.submit(store_traces, paths[first : first + at_once], first)
            for first in range(0, len(paths), at_once)
        )
        position = 0
        for stored in _in_turn(jobs, 2 * self._count):
            for key, found in stored:
                if isinstance(found, TraceFormatError):
                    yield found
                    continue
                if key:
                    self._shelf.keys[position] = key
                yield found.at(position)
                position += 1

    def close(self) -> None:
        """End the workers and remove temporary files."""
        if self._workers is not None:
            self._workers.shutdown(cancel_futures=True)
        if self._folder is not None:
            self._folder.cleanup()
        self._shelf.close()


def _is_large(batch: Batch) -> bool:
    """Return whether one group, or one run of a group, has more events than a batch is to have."""
    return sum(sum(exchange.counts) for exchange in batch.exchanges) > BATCH_EVENTS


def _is_long(paths: Sequence[Path]) -> bool:
    """Return whether traces are worth the start of worker processes."""
    if len(paths) >= _FILES_FOR_PROCESSES:
        return True
    sizes = (each.stat().st_size for path in paths if not is_remote(path) for each in (path, *path.glob("*")))
    return len(paths) > 1 and any(total >= _BYTES_FOR_PROCESSES for total in accumulate(sizes))


def _in_turn(begun: Iterator[Future[T]], ahead: int) -> Iterator[T]:
    """Yield results in order, while so many jobs behind the next one are under way or done.

    Args:
        begun: submits each job when it is asked for it.
        ahead: the number of jobs.

    Raises:
        TraceError: a worker process was killed.
    """
    pending: deque[Future[T]] = deque()
    try:
        for job in begun:
            pending.append(job)
            if len(pending) > ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    except BrokenProcessPool as err:
        raise TraceError(
            "a worker process of the analysis was killed, perhaps because memory ran out; analyze fewer recordings at once"
        ) from err
    finally:
        for job in pending:
            job.cancel()
