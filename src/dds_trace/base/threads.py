"""Ordered jobs on all cores; a lock and a scheduler change for threads that time stamps wait for."""

from __future__ import annotations

import atexit
import gc
import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Generic, Protocol, TypeVar, cast

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class PendingResult(Protocol[T_co]):
    def result(self) -> T_co: ...

    def cancel(self) -> bool: ...


def in_turn(jobs: Iterable[tuple[int, Callable[[], PendingResult[T]]]], most_jobs: int, most_size: int) -> Generator[T]:
    """Yield the results of (size, function that starts a job) pairs in order; a failing job raises here, perhaps before its turn.

    At most `most_jobs` jobs, with sizes of at most `most_size` in total, are started before their results are requested; a
    larger job runs by itself. Jobs that have not started when this is closed or fails never start.
    """
    started: deque[tuple[int, PendingResult[T]]] = deque()
    try:
        for size, start in jobs:
            while started and (len(started) >= most_jobs or size + sum(other for other, _ in started) > most_size):
                yield started.popleft()[1].result()
            started.append((size, start()))
        while started:
            yield started.popleft()[1].result()
    finally:
        for _, job in started:
            job.cancel()


def in_order(
    jobs: Iterable[tuple[int, Callable[[], T]]], pool: Executor, most_jobs: int, most_size: int
) -> Generator[T]:
    """Yield the results of (size, job) pairs in order; the waiting thread does jobs meanwhile, so that a pool needs one less."""
    waiting: deque[_SharedJob[T]] = deque()

    def start(job: Callable[[], T]) -> _SharedJob[T]:
        waiting.append(_SharedJob(job, pool.submit(job), waiting))
        return waiting[-1]

    return in_turn(((size, partial(start, job)) for size, job in jobs), most_jobs, most_size)


@dataclass(slots=True)
class _SharedJob(Generic[T]):
    """A job for the pool, or for a thread that waits for it or an earlier one."""

    job: Callable[[], T]
    future: Future[T]
    waiting: deque[_SharedJob[T]]

    def result(self) -> T:
        while not self.future.done() and any(job.done_here() for job in self.waiting):
            pass
        self.waiting.popleft()
        return self.future.result()

    def done_here(self) -> bool:
        if not self.cancel():
            return False
        self.future = InlineExecutor().submit(self.job)
        return True

    def cancel(self) -> bool:
        return self.future.cancel()


class InlineExecutor(Executor):
    """An executor without threads: `submit` does the job, and raises what it raises."""

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        future: Future[T] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class FastLock:
    """A lock that is fast when caches are cold and no other thread has it, as is usual when a message arrives.

    A `threading.Lock` then takes 6 to 9 us, this 2 (`benchmarks/performance.md`): a token in a list. Where each
    microsecond counts, write

        try:
            take()  # lock.take
        except IndexError:
            lock.wait()
        try:
            ...
        finally:
            give(None)  # lock.give
            if lock.is_awaited:
                lock.wake()

    and elsewhere `with lock:`. A signal handler must not raise in a thread that uses it: between `take` and `try` the
    token would be lost.
    """

    __slots__ = ("_queue", "_released", "give", "is_awaited", "take", "wake")

    def __init__(self) -> None:
        token = [None]
        self.take = cast("Callable[[], None]", token.pop)
        self.give = token.append
        self.is_awaited = False
        self._queue = threading.Lock()  # one thread waits for the token, the others for that thread
        self._released = threading.Event()
        self.wake = self._released.set

    def wait(self) -> None:
        with self._queue:
            self.is_awaited = True
            while True:
                # Clear before trying: a release after the try then sees `is_awaited`.
                self._released.clear()
                try:
                    self.take()
                except IndexError:
                    self._released.wait()
                else:
                    self.is_awaited = False
                    return

    def __enter__(self) -> None:
        try:
            self.take()
        except IndexError:
            self.wait()

    def __exit__(self, *_error: object) -> None:
        self.give(None)
        if self.is_awaited:
            self.wake()


def run_in_background() -> None:
    """Put this thread back under the ordinary scheduler, if allowed; it inherits SCHED_FIFO of `-o realtime`."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let a numpy that is imported, or a process that starts, have one thread for matrices: a second one of OpenBLAS waits busily."""
    name = "OPENBLAS_NUM_THREADS"
    is_set = name in os.environ  # by the user
    os.environ.setdefault(name, "1")
    try:
        yield
    finally:
        if not is_set:
            del os.environ[name]


NEW_OBJECTS = 10_000
"""Allocations between two collections of an analysis: Python's 700 cost 5 % of a worker's time."""


def tune_gc() -> None:
    """Tune an analysis, before any heavy import."""
    gc.set_threshold(NEW_OBJECTS)
    atexit.register(gc.freeze)
