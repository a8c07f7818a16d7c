"""How long a sweep takes: the schedules' own time, and what starting and ending a run adds as measured so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from .schedule import schedule

if TYPE_CHECKING:
    from .cells import Cell
    from .plan import Plan

RUN_OVERHEAD_S = 3.5
"""Start of the ping's process, discovery up to the echo, drain and close; measured with ROS 2 on two slow cores."""

BRIDGE_OVERHEAD_S = 2.0
"""A bridge has to start and be found as well."""

RELAY_OVERHEAD_S = 1.5
"""End of one relay and start of the next; the ping of its first cell waits for it."""


@dataclass(frozen=True, slots=True)
class Remaining:
    """Time that is left.

    Attributes:
        seconds: estimated.
    """

    seconds: float

    def __str__(self) -> str:
        minutes, seconds = divmod(round(self.seconds), 60)
        hours, minutes = divmod(minutes, 60)
        if hours:
            return f"{hours} h {minutes:02} min"
        return f"{minutes} min {seconds:02} s" if minutes else f"{seconds} s"


@dataclass(slots=True)
class Estimate:
    """Learns from each run what running costs beside the schedule."""

    plan: Plan
    _measured_s: list[float] = field(default_factory=list)

    def cell_seconds(self, cell: Cell) -> float:
        """Time that one run is expected to take, settling included."""
        overhead_s = RUN_OVERHEAD_S + BRIDGE_OVERHEAD_S * cell.crosses_domains
        if self._measured_s:
            overhead_s = sum(self._measured_s) / len(self._measured_s)
        return self.plan.run.planned_seconds(cell.rate) + overhead_s + self.plan.run.settle_seconds

    def measured(self, cell: Cell, seconds: float) -> None:
        """A run, from start to end of its ping, took so long."""
        self._measured_s.append(max(0.0, seconds - self.plan.run.planned_seconds(cell.rate)))

    def remaining(self, cells: list[Cell]) -> Remaining:
        """Time for these cells, relays' restarts left out."""
        return Remaining(sum(self.cell_seconds(cell) for cell in cells))


def plan_seconds(plan: Plan) -> Remaining:
    """Time for the whole plan."""
    groups = schedule(plan)
    estimate = Estimate(plan)
    runs_s = sum(estimate.remaining(list(group.cells)).seconds for group in groups)
    return Remaining(runs_s + RELAY_OVERHEAD_S * len(groups))
