"""Jobs done on all cores, their results in order: the thread that waits for the next result does others meanwhile."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Executor

T = TypeVar("T")


@dataclass(slots=True)
class _Begun(Generic[T]):
    size: int
    job: Callable[[], T]
    result: Future[T]

    def done_here(self) -> bool:
        """Do the job in this thread, unless one of the pool has it; False if there is nothing to do."""
        if not self.result.cancel():
            return False
        self.result = Future()
        self.result.set_result(self.job())
        return True


def in_order(
    jobs: Iterable[tuple[int, Callable[[], T]]], pool: Executor, most_jobs: int, most_size: int
) -> Iterator[T]:
    """The results of `jobs`, in order; where a job fails, its exception, which may be before its turn.

    Args:
        jobs: each with its size.
        pool: does them; one thread less than there are cores is enough.
        most_jobs: that are begun, or done, before their results are asked for.
        most_size: of all these together; a larger job is done alone.
    """
    begun: deque[_Begun[T]] = deque()
    for size, job in jobs:
        while begun and (len(begun) >= most_jobs or size + sum(one.size for one in begun) > most_size):
            yield _next_result(begun)
        begun.append(_Begun(size, job, pool.submit(job)))
    while begun:
        yield _next_result(begun)


def _next_result(begun: deque[_Begun[T]]) -> T:
    while not begun[0].result.done() and any(one.done_here() for one in begun):
        pass
    return begun.popleft().result.result()
