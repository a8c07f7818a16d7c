"""Worker processes of this machine: where arrays are short, Python between them keeps threads on one core.

A worker reads traces, puts their events into files (the user's cache, or temporary ones), and processes batches from
there. It returns rows in files, all else through pipes.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import TypeVar

from dds_trace.base.errors import TraceError, TraceFormatError

from ..cache.event_index import EventKey, EventPart
from ..cache.loaded import LoadedTrace, loaded_or_error
from ..cache.store import TraceCache
from ..cache.traces import TraceLoader
from ..groups.batch import Batch
from .batches import keep_freed_memory
from .gc_tuning import tune_gc
from .process import BatchOutput, process
from .result_cache import ResultCache

Stored = tuple[str, LoadedTrace | TraceFormatError]
"""Key in the cache or "", and the trace, or why the file is not one."""


T = TypeVar("T")
R = TypeVar("R")

_CHUNKS_PER_WORKER = 8
"""Chunks of a worker: few to send, none long to wait for."""


class Workers:
    """The workers of one analysis, at least two; the first free one takes the next job.

    This process is one: it has imported everything already.
    """

    def __init__(self, count: int, *, cache: bool) -> None:
        self.count = count
        self._folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")
        folder = Path(self._folder.name)
        self._pool = start_workers(count - 1, folder, cache=cache)
        self._here = Worker(folder, TraceCache.open() if cache else None, is_here=True)
        # A thread for each worker does the work of this process, or waits for another one.
        self._callers = iter([self._here.do, *[self._do_elsewhere] * (count - 1)])
        self._thread_local = threading.local()
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="worker", initializer=self._assign_worker)

    def store(self, paths: Sequence[Path], first: int) -> Future[list[Stored]]:
        """Let a worker load traces; see `Worker.store`."""
        return self._submit(Worker.store, paths, first)

    def process(
        self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], keys: Mapping[int, str]
    ) -> Future[BatchOutput]:
        """Let a worker process a batch; see `Worker.process`."""
        return self._submit(Worker.process, batch, parts, keys)

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        size = max(1, len(items) // (self.count * _CHUNKS_PER_WORKER))
        chunks = [items[first : first + size] for first in range(0, len(items), size)]
        with self.explaining_kills():
            pending = [self._submit(Worker.map, function, chunk) for chunk in chunks]
            return [result for chunk in pending for result in chunk.result()]

    @contextmanager
    def explaining_kills(self) -> Iterator[None]:
        try:
            yield
        except BrokenProcessPool as err:
            raise TraceError(
                "a worker process of the analysis was killed, perhaps because memory ran out; analyze fewer recordings at once"
            ) from err

    def close(self) -> None:
        self._threads.shutdown(cancel_futures=True)
        self._pool.shutdown(cancel_futures=True)
        self._here.close()
        self._folder.cleanup()

    def _submit(self, job: Callable[..., R], *arguments: object) -> Future[R]:
        return self._threads.submit(self._do, job, *arguments)

    def _assign_worker(self) -> None:
        self._thread_local.do = next(self._callers)

    def _do(self, job: Callable[..., R], *arguments: object) -> R:
        result: R = self._thread_local.do(job, *arguments)
        return result

    def _do_elsewhere(self, job: Callable[..., R], *arguments: object) -> R:
        return self._pool.submit(do_in_worker, job, *arguments).result()


class Worker:
    """Does the jobs of one process; `is_here` in the process of the analysis, which can take rows in memory.

    `folder` takes temporary files; the cache is closed with the worker.
    """

    def __init__(self, folder: Path, cache: TraceCache | None, *, is_here: bool = False) -> None:
        self._folder = folder
        self._is_here = is_here
        self._cache = cache
        self._loader = TraceLoader(cache, folder)

    def do(self, job: Callable[..., R], *arguments: object) -> R:
        """Do a job: one of the methods below."""
        return job(self, *arguments)

    def store(self, paths: Sequence[Path], first: int) -> list[Stored]:
        """Load traces, their events in files, numbered from `first`; no two calls may share numbers.

        Raises:
            OutputError: events cannot be written.
        """
        loaded = [loaded_or_error(self._loader.store, path, number) for number, path in enumerate(paths, first)]
        return [(self._loader.keys.pop(number, ""), trace) for number, trace in enumerate(loaded, first)]

    def process(
        self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], keys: Mapping[int, str]
    ) -> BatchOutput:
        """Pair and measure a batch, as `process.process`, events in files; `keys` by index of the trace.

        Raises:
            OutputError: the rows cannot be written.
        """
        output = process(batch, parts, ResultCache(self._cache, keys) if self._cache else None)
        return output if self._is_here else output.packed(self._folder)

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> list[R]:
        return list(map(function, items))

    def close(self) -> None:
        self._loader.close()


def can_start_workers() -> bool:
    return not multiprocessing.current_process().daemon


def start_workers(count: int, folder: Path, *, cache: bool) -> ProcessPoolExecutor:
    """Start processes that end with this one whatever ends it.

    The caller removes `folder`, which takes temporary files, after they have ended.
    """
    # A fork would copy locks that other threads, also in polars, have taken.
    context = multiprocessing.get_context("spawn")
    workers = ProcessPoolExecutor(count, context, _begin, (os.fspath(folder), cache))
    with _without_main(), _without_interrupts(), _with_one_blas_thread():
        for _ in range(count):
            workers.submit(os.getpid)  # each starts one
    return workers


def do_in_worker(job: Callable[..., R], *arguments: object) -> R:
    assert _worker is not None
    return _worker.do(job, *arguments)


_worker: Worker | None = None


def _begin(folder: str, has_cache: bool) -> None:
    global _worker  # noqa: PLW0603 - set once, when the process starts
    keep_freed_memory()
    tune_gc()
    threading.Thread(target=_end_with_caller, daemon=True).start()
    _worker = Worker(Path(folder), TraceCache.open() if has_cache else None)


def _end_with_caller() -> None:
    """End with a killed caller: other workers keep its end of the pipe open."""
    caller = multiprocessing.parent_process()
    assert caller is not None
    wait([caller.sentinel])
    os._exit(1)


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the calling program: a spawned process would run it again."""
    main = sys.modules["__main__"]
    hidden = {name: getattr(main, name, None) for name in ("__file__", "__spec__")}
    try:
        for name in hidden:
            setattr(main, name, None)
        yield
    finally:
        for name, value in hidden.items():
            setattr(main, name, value)


@contextmanager
def _with_one_blas_thread() -> Iterator[None]:
    name = "OPENBLAS_NUM_THREADS"
    if name in os.environ:  # the user's own
        yield
        return
    os.environ[name] = "1"
    try:
        yield
    finally:
        del os.environ[name]


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block Ctrl-C in spawned processes: the caller gets it and ends them."""
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)
