"""Times without messages that were due, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.units import SECOND_NS

Int64 = NDArray[np.int64]


def _none() -> Int64:
    return np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Holes:
    """Times without messages that were due, ascending: the first of them, its duration, how many messages, and at least how many."""

    start_ns: Int64 = field(default_factory=_none)
    duration_ns: Int64 = field(default_factory=_none)
    missing: Int64 = field(default_factory=_none)
    low: Int64 = field(default_factory=_none)

    def __len__(self) -> int:
        return len(self.start_ns)

    @property
    def end_ns(self) -> Int64:
        return self.start_ns + self.duration_ns

    def seconds(self, start_ns: int) -> list[tuple[float, float]]:
        times_ns = np.stack([self.start_ns - start_ns, self.duration_ns], axis=1)
        return [(start_s, duration_s) for start_s, duration_s in (times_ns / SECOND_NS).tolist()]

    def at(self, selected: NDArray[np.bool_] | Int64) -> Holes:
        return Holes(*(column[selected] for column in (self.start_ns, self.duration_ns, self.missing, self.low)))

    def meet(self, others: Holes) -> NDArray[np.bool_]:
        """Return which of these overlap any of the others, which do not overlap each other."""
        if not (len(self) and len(others)):
            return np.zeros(len(self), np.bool_)
        at = others.end_ns.searchsorted(self.start_ns, "right")
        return np.append(others.start_ns, np.iinfo(np.int64).max)[at] < self.end_ns

    @staticmethod
    def of(parts: Sequence[Holes]) -> Holes:
        columns = (("start_ns", "duration_ns", "missing", "low"), parts or [Holes()])
        start, *others = (np.concatenate([getattr(part, name) for part in columns[1]]) for name in columns[0])
        order = np.argsort(start, kind="stable")
        return Holes(start[order], *(column[order] for column in others))

    @staticmethod
    def due(last_ns: Int64, wait_ns: Int64, period_ns: float, missing: Int64, low: Int64) -> Holes:
        """Return holes that begin when a message was due."""
        start, duration = (
            np.rint(times_ns).astype(np.int64) for times_ns in (last_ns + period_ns, wait_ns - period_ns)
        )
        return Holes(start, np.maximum(duration, 0), missing, low)

    @staticmethod
    def between(starts_ns: Sequence[int], ends_ns: Sequence[int]) -> Holes:
        start, zeros = np.array(starts_ns, np.int64), np.zeros(len(starts_ns), np.int64)
        return Holes(start, np.array(ends_ns, np.int64) - start, zeros, zeros)
