"""Threads: jobs on all cores with results in order, and work in the background that must not delay a time stamp."""

from __future__ import annotations

import os
import threading
from collections import deque
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class PendingResult(Protocol[T_co]):
    """A job that was begun: a future of a pool is one."""

    def result(self) -> T_co:
        """Wait for the job's end and return what it gave, or raise what it raised."""

    def cancel(self) -> bool:
        """See to it that the job never begins, if it has not."""


def in_turn(
    jobs: Iterable[tuple[int, Callable[[], PendingResult[T]]]], most_jobs: int, most_size: int
) -> Iterator[T]:
    """Yield the results of `jobs` in order; a job that fails raises its exception here, perhaps before its turn.

    Jobs that have not begun when this ends early, by an exception or because nobody wants more results, never begin.

    Args:
        jobs: (size, what begins it) pairs.
        most_jobs: the number of jobs that are begun, or done, before their results are asked for.
        most_size: the sum of the sizes of all these; a larger job is done alone.
    """
    begun: deque[tuple[int, PendingResult[T]]] = deque()
    try:
        for size, begin in jobs:
            while begun and (
                len(begun) >= most_jobs or size + sum(of_job for of_job, _ in begun) > most_size
            ):
                yield begun.popleft()[1].result()
            begun.append((size, begin()))
        while begun:
            yield begun.popleft()[1].result()
    finally:
        for _, job in begun:
            job.cancel()


def in_order(
    jobs: Iterable[tuple[int, Callable[[], T]]], pool: Executor, most_jobs: int, most_size: int
) -> Iterator[T]:
    """Yield the results of `jobs` in order as `in_turn` does.

    The thread that waits for a result does jobs meanwhile, so that a pool with one thread less than there are cores is enough.

    Args:
        jobs: (size, job) pairs.
        pool: the threads that do the jobs.
        most_jobs: as for `in_turn`.
        most_size: as for `in_turn`.
    """
    waiting: deque[_Shared[T]] = deque()

    def begin(job: Callable[[], T]) -> _Shared[T]:
        waiting.append(_Shared(job, pool.submit(job), waiting))
        return waiting[-1]

    return in_turn(((size, partial(begin, job)) for size, job in jobs), most_jobs, most_size)


@dataclass(slots=True)
class _Shared(Generic[T]):
    """A job that the pool does, or the thread that waits for it or for one before it.

    Attributes:
        job: the job.
        future: its result.
        waiting: this job and those behind it, in their order.
    """

    job: Callable[[], T]
    future: Future[T]
    waiting: deque[_Shared[T]]

    def result(self) -> T:
        """Do jobs that no thread has taken until this one is done; return its result."""
        while not self.future.done() and any(one.done_here() for one in self.waiting):
            pass
        self.waiting.popleft()
        return self.future.result()

    def done_here(self) -> bool:
        """Do the job in this thread unless a thread of the pool has it; return whether it was done here."""
        if not self.cancel():
            return False
        self.future = Future()
        self.future.set_result(self.job())
        return True

    def cancel(self) -> bool:
        """See to it that the pool never begins the job, if it has not."""
        return self.future.cancel()


class InlineExecutor(Executor):
    """An executor without threads: each job is done by the one who submits it, at once."""

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Do the job; what it raises is raised here."""
        done: Future[T] = Future()
        done.set_result(fn(*args, **kwargs))
        return done


class FastLock:
    """A lock that is quick when caches are cold and nobody else has it, as is the rule beside a message.

    A `threading.Lock` then takes 6 to 9 us, this 2 (`docs/explanation/performance.md`): it is a token in a list, which one
    thread has at a time. Where each microsecond counts, write

        try:
            take()  # turn.take
        except IndexError:
            turn.wait()
        try:
            ...
        finally:
            give(None)  # turn.give
            if turn.is_awaited:
                turn.wake()

    and everywhere else `with turn:`. Unlike a lock it is not for a thread that a signal handler may interrupt by an exception:
    between `take` and `try` the token would be lost.

    Attributes:
        take: takes the token, or raises `IndexError` if another thread has it.
        give: gives it back; its argument is None.
        is_awaited: whether somebody waits for it, whom `wake` then tells.
    """

    __slots__ = ("_queue", "_told", "give", "is_awaited", "take", "wake")

    def __init__(self) -> None:
        token = [None]
        self.take = cast("Callable[[], None]", token.pop)
        self.give = token.append
        self.is_awaited = False
        self._queue = threading.Lock()  # one waits for the token, the others for that one
        self._told = threading.Event()
        self.wake = self._told.set

    def wait(self) -> None:
        """Take the token as soon as it is there."""
        with self._queue:
            self.is_awaited = True
            while True:
                # First the mark, then the look: who gives the token back behind the look sees the mark.
                self._told.clear()
                try:
                    self.take()
                except IndexError:
                    self._told.wait()
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
    """Put the calling thread back under the ordinary scheduler.

    A thread inherits SCHED_FIFO from the one that starts it (`dds-record --realtime`). Never raises: without the
    right to change the scheduler there was no real-time priority to inherit, nor is there one outside of Linux.
    """
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
