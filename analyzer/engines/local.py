"""An engine loads traces and processes batches: this machine here, a cluster in `cluster.py`."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.threads import in_turn

from ..groups.batch import Batch
from ..loading.campaign import Campaign, Progress, load_campaign
from ..loading.event_index import EventIndex
from ..loading.place import Place
from ..loading.traces import LoadedTrace, TraceSpool, load, load_some
from .batches import BatchOutput, is_large, keep_freed_memory, process

_MOST_THREADS = 2  # each has a batch in memory; the caller writes the rows

_MOST_EVENTS_AHEAD = 8_000_000
"""Events of batches in progress or with waiting results; a larger batch is processed on its own."""

FILES_FOR_PROCESSES = 2_000
"""Traces from which on worker processes pay (`benchmarks/performance.md`)."""

_FILES_PER_JOB = 16


class Engine(ExitStack):
    """Two threads of this machine, or processes where there are many traces; a `spool` of the caller stays open."""

    takes_large_batches = False
    """Whether the executor does: their rows are too many for a pipe."""

    def __init__(self, spool: TraceSpool | None = None) -> None:
        super().__init__()
        self._spool = spool or self.enter_context(closing(TraceSpool()))
        self._count = min(_MOST_THREADS, len(os.sched_getaffinity(0)))
        self._executor: Executor | None = None

    def load(self, location: Place, skip: Collection[Path], progress: Progress | None) -> Campaign:
        load_all = partial(self._spool.load_all, load_new=self._load_new)
        return load_campaign(location, load_all, skip=skip, progress=progress)

    def process(self, batches: Sequence[Batch], index: EventIndex) -> Iterator[BatchOutput]:
        """Yield rows and results of the batches, in their order; two threads measure while the caller writes rows."""
        if not any(map(is_large, batches)):  # a large one leaves no room
            keep_freed_memory()
        with ThreadPoolExecutor(self._count, thread_name_prefix="analyze") as threads:

            def begin(batch: Batch) -> Future[BatchOutput]:
                parts = {key: index[key] for key in batch.event_keys() if key in index}
                others = self._executor if self.takes_large_batches or not is_large(batch) else None
                return (others or threads).submit(process, batch, parts)

            jobs = ((batch.events, partial(begin, batch)) for batch in batches)
            yield from in_turn(jobs, self._count + 1, _MOST_EVENTS_AHEAD)

    def _load_here(self, paths: Iterable[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        room = self._spool.room()
        for path in paths:
            trace = load(path, self._spool.folder, room)
            if isinstance(trace, LoadedTrace):
                room = max(0, room - trace.events)
            yield trace

    def _load_new(self, paths: Sequence[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        if len(paths) >= FILES_FOR_PROCESSES and self._count > 1:
            from .processes import can_start_processes, processes  # noqa: PLC0415 - few analyses need multiprocessing

            if can_start_processes():
                self._executor = self.enter_context(processes(self._count))
        if self._executor is None:
            return self._load_here(paths)
        firsts = range(0, len(paths), _FILES_PER_JOB)
        batches = ([*paths[first : first + _FILES_PER_JOB]] for first in firsts)
        jobs = ((0, partial(self._executor.submit, load_some, part, self._spool.folder)) for part in batches)
        return (trace for traces in in_turn(jobs, 2 * self._count + 1, 0) for trace in traces)
