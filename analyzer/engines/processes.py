"""Worker processes of this machine: what is Python between short arrays takes one core in threads, however many there are.

A worker reads traces, puts their events into files (the user's cache, or temporary ones), and works at batches whose events
it reads from there. Rows travel in files, too, encoded as they will be in their Parquet file; descriptions, batches and all other
results through pipes.
"""

from __future__ import annotations

import atexit
import gc
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from dds_trace.tracefile import TraceError

from ..loading.cache import TraceCache
from ..loading.shelf import TraceShelf
from ..loading.traces import loaded_or_error
from .batches import keep_freed_memory
from .known_batches import encoded_batch
from .known_details import KnownDetails

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from concurrent.futures import Future

    from dds_trace.tracefile import TraceFormatError

    from ..groups.batch import Batch
    from ..loading.events import EventKey, EventPart
    from ..loading.traces import LoadedTrace
    from .batches import WorkedBatch

    Stored = tuple[str, LoadedTrace | TraceFormatError]
    """Key in the cache, "" without one, and the trace, or why the file is none."""

T = TypeVar("T")
R = TypeVar("R")

_PIECES_OF_WORKER = 8
"""Parts that each worker does of what is mapped: so few that little travels, so many that none waits long for another."""


class Workers:
    """The worker processes of one analysis, and the folder of their temporary files; closed at the end.

    Args:
        count: number of processes.
        cache: whether they keep events and details in the user's cache.
    """

    def __init__(self, count: int, *, cache: bool) -> None:
        self.count = count
        self._folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")
        self._pool = start_workers(count, Path(self._folder.name), cache=cache)

    def store(self, paths: Sequence[Path], first: int) -> Future[list[Stored]]:
        """Let a worker load traces; see `store_traces`."""
        return self._pool.submit(store_traces, paths, first)

    def work(
        self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], keys: Mapping[int, str]
    ) -> Future[WorkedBatch]:
        """Let a worker pair and measure a batch; see `work_in_worker`."""
        return self._pool.submit(work_in_worker, batch, parts, keys)

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        """Return the function's results in the order of the items."""
        pieces = self.count * _PIECES_OF_WORKER
        with self.telling():
            return list(self._pool.map(function, items, chunksize=max(1, len(items) // pieces)))

    @contextmanager
    def telling(self) -> Iterator[None]:
        """Turn the end of a process into an error that says what may have ended it."""
        try:
            yield
        except BrokenProcessPool as err:
            raise TraceError(
                "a worker process of the analysis was killed, perhaps because memory ran out; analyze fewer recordings at once"
            ) from err

    def close(self) -> None:
        """End the processes and remove their files."""
        self._pool.shutdown(cancel_futures=True)
        self._folder.cleanup()


def can_start_workers() -> bool:
    """Return whether this process may have others: one of `multiprocessing` that ends with its own caller may not."""
    return not multiprocessing.current_process().daemon


def start_workers(count: int, folder: Path, *, cache: bool) -> ProcessPoolExecutor:
    """Start worker processes, which end with this one whatever ends it.

    Args:
        count: number of processes.
        folder: takes temporary files; the caller removes it behind the workers' end.
        cache: whether they keep events and details in the user's cache.
    """
    context = multiprocessing.get_context(
        "spawn"
    )  # a fork would copy the locks of other threads, of polars too
    workers = ProcessPoolExecutor(count, context, _begin, (os.fspath(folder), cache))
    with _without_main(), _without_interrupts(), _with_one_thread_of_blas():
        for _ in range(count):
            workers.submit(os.getpid)  # each starts one
    return workers


def store_traces(paths: Sequence[Path], first: int) -> list[Stored]:
    """Load traces in a worker, their events in files.

    Args:
        paths: files or folders.
        first: a number for the first one, as no other call has for any.

    Raises:
        OutputError: events could not be kept.
    """
    loaded = [loaded_or_error(_shelf.store, path, number) for number, path in enumerate(paths, first)]
    return [(_shelf.keys.pop(number, ""), found) for number, found in enumerate(loaded, first)]


def work_in_worker(
    batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], keys: Mapping[int, str]
) -> WorkedBatch:
    """Pair and measure a batch in a worker, its rows in a file; see `known_batches.encoded_batch`.

    Args:
        batch: the batch.
        parts: of its `event_keys` the rows of the event index, events in files.
        keys: of its traces, by position, the key in the cache.

    Raises:
        OutputError: the rows could not be kept.
    """
    assert _folder is not None
    return encoded_batch(batch, parts, KnownDetails(_cache, keys) if _cache else None, _folder)


_folder: Path | None = None
_cache: TraceCache | None = None
_shelf = TraceShelf()


def _begin(folder: str, has_cache: bool) -> None:
    """Make this process a worker."""
    global _folder, _cache, _shelf  # noqa: PLW0603 - what a process has from its beginning
    keep_freed_memory()
    atexit.register(gc.freeze)  # else the collector looks at every object again before the process ends
    threading.Thread(target=_end_with_caller, daemon=True).start()
    _folder = Path(folder)
    _cache = TraceCache.open() if has_cache else None
    _shelf = TraceShelf(_cache, _folder)


def _end_with_caller() -> None:
    """End this process where the caller was killed: its end of the pipe, which others hold too, would stay open."""
    caller = multiprocessing.parent_process()
    assert caller is not None
    wait([caller.sentinel])
    os._exit(1)


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the program that called us: a process that is started would run it again, from which `analyze` may be called."""
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
def _with_one_thread_of_blas() -> Iterator[None]:
    """Let processes that are started multiply their small matrices alone: a second thread takes a core from another one."""
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
    """Hold Ctrl-C back from processes that are started, for good: it is the caller's, who ends them."""
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
