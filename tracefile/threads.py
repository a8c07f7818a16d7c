"""Threads: jobs on all cores with results in order, and work in the background that must not delay a time stamp."""

from __future__ import annotations

import os
import threading
from collections import deque
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

T = TypeVar("T")


@dataclass(slots=True)
class _Begun(Generic[T]):
    """A job that was handed to the pool."""

    size: int
    job: Callable[[], T]
    result: Future[T]

    def done_here(self) -> bool:
        """Do the job in this thread unless a thread of the pool has it; return whether it was done here."""
        if not self.result.cancel():
            return False
        self.result = Future()
        self.result.set_result(self.job())
        return True


def in_order(
    jobs: Iterable[tuple[int, Callable[[], T]]],
    pool: Executor,
    most_jobs: int,
    most_size: int,
) -> Iterator[T]:
    """Yield the results of `jobs` in order; a job that fails raises its exception here, perhaps before its turn.

    Jobs that have not begun when this ends early, by an exception or because nobody wants more results, never begin. The thread
    that waits for a result does jobs meanwhile, so that a pool with one thread less than there are cores is enough.

    Args:
        jobs: (size, job) pairs.
        pool: the threads that do the jobs.
        most_jobs: the number of jobs that are begun, or done, before their results are asked for.
        most_size: the sum of the sizes of all these; a larger job is done alone.
    """
    begun: deque[_Begun[T]] = deque()
    try:
        for size, job in jobs:
            while begun and (len(begun) >= most_jobs or size + sum(one.size for one in begun) > most_size):
                yield _next_result(begun)
            begun.append(_Begun(size, job, pool.submit(job)))
        while begun:
            yield _next_result(begun)
    finally:
        for one in begun:
            one.result.cancel()


def _next_result(begun: deque[_Begun[T]]) -> T:
    while not begun[0].result.done() and any(one.done_here() for one in begun):
        pass
    return begun.popleft().result.result()


class Here(Executor):
    """An executor without threads: each job is done by the one who submits it, at once."""

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Do the job; what it raises is raised here."""
        done: Future[T] = Future()
        done.set_result(fn(*args, **kwargs))
        return done


class Turn:
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
