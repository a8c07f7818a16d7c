"""The schedule of a plan: the order in which its cells run, grouped by the relay that serves them, and its duration."""

from __future__ import annotations

import random
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from .plan import Order

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .cells import Cell, RelayNeed
    from .plan import Plan

RUN_OVERHEAD_S = 3.5
"""Start of the ping's process, discovery up to the echo, drain and close; measured with ROS 2 on two slow cores."""

BRIDGE_OVERHEAD_S = 2.0
"""Start and discovery of a bridge."""

RELAY_OVERHEAD_S = 1.5
"""End of one relay and start of the next, for which the ping of its first cell waits."""


@dataclass(frozen=True, slots=True)
class CellGroup:
    """Cells that one relay serves without a restart, in the order in which they run.

    Attributes:
        number: 1, 2 ... in the order in which the groups run.
        need: parameters of the relay.
        bridge: bridge of all the cells, if one half of it runs beside the ping and one beside the relay; else None.
        cells: the cells.
    """

    number: int
    need: RelayNeed
    bridge: str | None
    cells: tuple[Cell, ...]


def schedule(plan: Plan) -> list[CellGroup]:
    """Return all cells of the plan, each once for each repeat, in groups of one relay.

    `shuffled` shuffles the relays of each pass and the cells of each relay, not all cells at once: a relay
    serves its cells without a restart, and with several repeats two middlewares meet the machine's drift
    alike. The order depends on the plan's seed alone, so an interrupted sweep goes on in it.
    """
    groups: list[CellGroup] = []
    for repeat in range(1, plan.run.repeats + 1):
        of_pass = group_by_relay(plan, [replace(cell, repeat=repeat) for cell in plan.cells])
        if plan.run.order is Order.SHUFFLED:
            chance = random.Random(f"{plan.run.seed} {repeat}")  # noqa: S311 - an order, not a secret
            chance.shuffle(of_pass)
            of_pass = [
                replace(group, cells=tuple(chance.sample(group.cells, len(group.cells)))) for group in of_pass
            ]
        groups += of_pass
    return [replace(group, number=number) for number, group in enumerate(groups, 1)]


def group_by_relay(plan: Plan, cells: Iterable[Cell]) -> list[CellGroup]:
    """Return the cells in groups of one relay, relays and cells in the order of their first appearance."""
    served: dict[tuple[RelayNeed, str | None], list[Cell]] = {}
    for cell in cells:
        beside_relay = cell.bridge if plan.runs_halves(cell) else None
        served.setdefault((cell.relay, beside_relay), []).append(cell)
    return [
        CellGroup(number, need, bridge, tuple(listed))
        for number, ((need, bridge), listed) in enumerate(served.items(), 1)
    ]


@dataclass(frozen=True, slots=True)
class Remaining:
    """An estimate of the time that is left.

    Attributes:
        seconds: the estimate.
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
    """The duration of runs: their schedules, and the overhead of starting and ending one as measured so far."""

    plan: Plan
    _measured_s: list[float] = field(default_factory=list)

    def cell_seconds(self, cell: Cell) -> float:
        """Return the expected time of one run, settling included."""
        overhead_s = RUN_OVERHEAD_S + BRIDGE_OVERHEAD_S * cell.crosses_domains
        if self._measured_s:
            overhead_s = sum(self._measured_s) / len(self._measured_s)
        return self.plan.run.planned_seconds(cell.rate) + overhead_s + self.plan.run.settle_seconds

    def measured(self, cell: Cell, seconds: float) -> None:
        """Take the measured time of a run, from start to end of its ping, into the estimate."""
        self._measured_s.append(max(0.0, seconds - self.plan.run.planned_seconds(cell.rate)))

    def remaining(self, cells: list[Cell]) -> Remaining:
        """Return the expected time of these cells, without the restarts of relays."""
        return Remaining(sum(self.cell_seconds(cell) for cell in cells))


def plan_seconds(plan: Plan) -> Remaining:
    """Return the expected time of the whole plan."""
    groups = schedule(plan)
    estimate = Estimate(plan)
    runs_s = sum(estimate.remaining(list(group.cells)).seconds for group in groups)
    return Remaining(runs_s + RELAY_OVERHEAD_S * len(groups))
