"""Worker processes of this machine: what is Python between short arrays takes one core in threads, however many there are.

A worker reads traces, puts their events into files (the user's cache, or temporary ones), and works at batches whose events
it reads from there. Rows of another process come in files, too, encoded as they will be in their Parquet file; descriptions,
batches and all other results through pipes. One worker is the process of the analysis itself.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from dds_trace.base.errors import TraceError

from ..cache.loaded import loaded_or_error
from ..cache.store import TraceCache
from ..cache.traces import TraceShelf
from .batches import keep_freed_memory
from .cached_batches import encoded_batch
from .cached_details import KnownDetails
from .gc_tuning import tune_gc

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from concurrent.futures import Future

    from dds_trace.base.errors import TraceFormatError

    from ..cache.event_index import EventKey, EventPart
    from ..cache.loaded import LoadedTrace
    from ..groups.batch import Batch
    from .batches import WorkedBatch

    Stored = tuple[str, LoadedTrace | TraceFormatError]
    """Key in the cache, "" without one, and the trace, or why the file is none."""


T = TypeVar("T")
R = TypeVar("R")

_PIECES_OF_WORKER = 8
"""Parts that each worker does of what is mapped: so few that little travels, so many that none waits long for another."""


class Workers:
    """The workers of one analysis: processes, and this one; closed at the end.

    A job goes to whichever is free first. This process is one of them because it has imported everything already, which takes
    another one a third of a second of a core, and has little else to do meanwhile: what the others do reaches it encoded.

    Args:
        count: number of workers, at least two.
        cache: whether they keep events and details in the user's cache.
    """

    def __init__(self, count: int, *, cache: bool) -> None:
        self.count = count
        self._folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")
        folder = Path(self._folder.name)
        self._pool = start_workers(count - 1, folder, cache=cache)
        self._here = Worker(folder, TraceCache.open() if cache else None, is_here=True)
        # One thread for each worker: it does what this process does, or waits for what another one does.
        self._places = iter([self._here.do, *[self._do_elsewhere] * (count - 1)])
        self._of_thread = threading.local()
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="worker", initializer=self._take_place)

    def store(self, paths: Sequence[Path], first: int) -> Future[list[Stored]]:
        """Let a worker load traces; see `Worker.store`."""
        return self._submit(Worker.store, paths, first)

    def work(
        self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], keys: Mapping[int, str]
    ) -> Future[WorkedBatch]:
        """Let a worker pair and measure a batch; see `Worker.work`."""
        return self._submit(Worker.work, batch, parts, keys)

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        """Return the function's results in the order of the items."""
        at_once = max(1, len(items) // (self.count * _PIECES_OF_WORKER))
        pieces = [items[first : first + at_once] for first in range(0, len(items), at_once)]
        with self.telling():
            begun = [self._submit(Worker.map, function, piece) for piece in pieces]
            return [result for piece in begun for result in piece.result()]

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
        self._threads.shutdown(cancel_futures=True)
        self._pool.shutdown(cancel_futures=True)
        self._here.close()
        self._folder.cleanup()

    def _submit(self, job: Callable[..., R], *arguments: object) -> Future[R]:
        return self._threads.submit(self._do, job, *arguments)

    def _take_place(self) -> None:
        self._of_thread.do = next(self._places)

    def _do(self, job: Callable[..., R], *arguments: object) -> R:
        result: R = self._of_thread.do(job, *arguments)
        return result

    def _do_elsewhere(self, job: Callable[..., R], *arguments: object) -> R:
        return self._pool.submit(do_in_worker, job, *arguments).result()


class Worker:
    """What does the jobs of one process.

    Args:
        folder: takes temporary files.
        cache: the open cache, which is closed with the worker; None keeps nothing.
        is_here: whether it works in the process of the analysis, which then has rows of new batches in memory.
    """

    def __init__(self, folder: Path, cache: TraceCache | None, *, is_here: bool = False) -> None:
        self._rows_folder = None if is_here else folder
        self._cache = cache
        self._shelf = TraceShelf(cache, folder)

    def do(self, job: Callable[..., R], *arguments: object) -> R:
        """Do a job: one of the methods below."""
        return job(self, *arguments)

    def store(self, paths: Sequence[Path], first: int) -> list[Stored]:
        """Load traces, their events in files.

        Args:
            paths: files or folders.
            first: a number for the first one, as no other call has for any.

        Raises:
            OutputError: events could not be kept.
        """
        loaded = [
            loaded_or_error(self._shelf.store, path, number) for number, path in enumerate(paths, first)
        ]
        return [(self._shelf.keys.pop(number, ""), found) for number, found in enumerate(loaded, first)]

    def work(
        self, batch: Batch, parts: Mapping[EventKey, Sequence[EventPart]], keys: Mapping[int, str]
    ) -> WorkedBatch:
        """Pair and measure a batch, its rows encoded; see `cached_batches.encoded_batch`.

        Args:
            batch: the batch.
            parts: of its `event_keys` the rows of the event index, events in files.
            keys: of its traces, by position, the key in the cache.

        Raises:
            OutputError: the rows could not be kept.
        """
        return encoded_batch(
            batch, parts, KnownDetails(self._cache, keys) if self._cache else None, self._rows_folder
        )

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """Return the function's results."""
        return list(map(function, items))

    def close(self) -> None:
        """Close the cache."""
        self._shelf.close()


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


def do_in_worker(job: Callable[..., R], *arguments: object) -> R:
    """Do a job in a worker process."""
    assert _worker is not None
    return _worker.do(job, *arguments)


_worker: Worker | None = None


def _begin(folder: str, has_cache: bool) -> None:
    """Make this process a worker."""
    global _worker  # noqa: PLW0603 - what a process has from its beginning
    keep_freed_memory()
    tune_gc()
    threading.Thread(target=_end_with_caller, daemon=True).start()
    _worker = Worker(Path(folder), TraceCache.open() if has_cache else None)


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
