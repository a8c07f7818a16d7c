"""Outages that a sweep makes in the middle of a run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypedDict

from ..plan.cells import Cell, OutageBy
from ..plan.plan import RunSettings
from ..station.namespaces import NamespacePair


class OutageReport(TypedDict):
    """One outage of a run, on this machine's CLOCK_MONOTONIC; `limit_s`: how long the run waited for a message after it.

    Of a link, `began_ns` and `ended_ns` are when the kernel took it down and up.
    """

    by: str
    seconds: float
    began_ns: int
    ended_ns: int
    limit_s: float


class Outage:
    """One outage of one run; `kill` and `serve` are of the relay, `pair` the two namespaces.

    The caller calls `step` again and again from the first message on.
    """

    def __init__(
        self,
        cell: Cell,
        run: RunSettings,
        *,
        pair: NamespacePair | None,
        kill: Callable[[], object],
        serve: Callable[[], object],
    ) -> None:
        self._by = OutageBy(cell.outage_by)
        self._seconds = float(str(cell.outage))
        self._run = run
        self._pair = pair
        self._kill = kill
        self._serve = serve
        self._due_s: float | None = None
        self._began_ns = self._ended_ns = 0

    def step(self, now_s: float) -> None:
        if self._due_s is None:
            self._due_s = now_s + self._run.outage_after_seconds
        if not self._began_ns and now_s >= self._due_s:
            self._began_ns = self._cut()
        if self._began_ns and not self._ended_ns:
            left_s = self._seconds - (time.monotonic_ns() - self._began_ns) / 1e9
            if left_s <= _LONGEST_WAIT_S:
                time.sleep(max(left_s, 0.0))
                if self._pair is not None and self._by is not OutageBy.RELAY:
                    self._ended_ns = self._pair.restore(self._by)
                else:
                    self._serve()
                    self._ended_ns = time.monotonic_ns()

    def report(self) -> OutageReport | None:
        if not self._ended_ns:
            return None
        return {
            "by": self._by.value,
            "seconds": self._seconds,
            "began_ns": self._began_ns,
            "ended_ns": self._ended_ns,
            "limit_s": self._run.outage_limit_seconds,
        }

    @contextmanager
    def repaired(self) -> Iterator[None]:
        try:
            yield
        finally:
            if self._pair is not None:
                self._pair.repair()

    def _cut(self) -> int:
        if self._by is OutageBy.RELAY:
            began_ns = time.monotonic_ns()
            self._kill()
            return began_ns
        assert self._pair is not None  # the plan was checked
        return self._pair.cut(self._by)


_LONGEST_WAIT_S = 0.25
