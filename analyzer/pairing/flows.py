"""Runs of one machine at the same time: flows of each run, and overlaps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

OVERLAP_NS = 1_000_000_000
"""Least common time of two runs, as NTP slews wall clocks, unless one goes on in the middle of the other."""


@dataclass(frozen=True, slots=True, order=True)
class RunSpan:
    """A run from its first to its last T1, wall clock, on the machine of its ping (`boots.machine_of`)."""

    start_ns: int
    end_ns: int
    run_id: int
    machine: str

    @property
    def middle_ns(self) -> int:
        return (self.start_ns + self.end_ns) // 2

    def includes(self, instant_ns: int) -> bool:
        return self.start_ns <= instant_ns <= self.end_ns


@dataclass(frozen=True, slots=True)
class Overlap:
    """Two runs of one machine that went on at the same time, by start.

    Attributes:
        share: common time over the duration of the shorter run, 0 to 1.
        is_mutual: each went on in the middle of the other, so that both count it as a flow.
    """

    one: int
    other: int
    share: float
    is_mutual: bool


def count_flows(spans: Iterable[RunSpan]) -> dict[int, int]:
    flows: dict[int, int] = {}
    for spans_of_machine in _by_machine(spans):
        middles = np.array([span.middle_ns for span in spans_of_machine])
        begun = np.sort([span.start_ns for span in spans_of_machine]).searchsorted(middles, side="right")
        ended = np.sort([span.end_ns for span in spans_of_machine]).searchsorted(middles, side="left")
        flows |= zip([span.run_id for span in spans_of_machine], (begun - ended).tolist(), strict=True)
    return flows


def find_overlaps(spans: Iterable[RunSpan]) -> Iterator[Overlap]:
    """Yield pairs of runs of one machine that overlap by a second, or at the middle of one."""
    for spans_of_machine in _by_machine(spans):
        going_on: list[RunSpan] = []
        for span in sorted(spans_of_machine):
            going_on = [other for other in going_on if other.end_ns >= span.start_ns]
            for other in going_on:
                common_ns = min(span.end_ns, other.end_ns) - span.start_ns
                in_middle = other.includes(span.middle_ns), span.includes(other.middle_ns)
                if common_ns >= OVERLAP_NS or any(in_middle):
                    shorter_ns = min(span.end_ns - span.start_ns, other.end_ns - other.start_ns)
                    share = common_ns / shorter_ns if shorter_ns else 1.0
                    yield Overlap(other.run_id, span.run_id, share, all(in_middle))
            going_on.append(span)


def _by_machine(spans: Iterable[RunSpan]) -> Iterable[list[RunSpan]]:
    machines: dict[str, dict[int, RunSpan]] = defaultdict(dict)
    for span in spans:
        machines[span.machine][span.run_id] = span
    return [list(spans_of_machine.values()) for spans_of_machine in machines.values()]
