"""The order of a plan's cells, grouped by their relay, and its duration."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

from dds_trace.recorder.backends import load_backend

from .cells import Cell
from .flows import recorded_together
from .plan import Order, Plan

RUN_OVERHEAD_S = 1.0
"""Start, discovery, drain and close of a ping, measured on two busy cores."""

OWN_COST_S = 1.0

BRIDGE_OVERHEAD_S = 5.0

RELAY_OVERHEAD_S = 1.0

LOSS_OVERHEAD_S = 2.5
"""Wait for lost replies, a new relay and its discovery, in half of the recordings that may lose some."""

SLOW_LOSS_S, LARGE_BYTES = 10.0, 65_000
"""The same of Fast DDS and large messages: it sends 64 KB at once, and again at its next heartbeat, up to 3 s later."""


def start_lead_s(pings: int) -> float:
    return 3.0 + pings if pings > 1 else 0.0


@dataclass(frozen=True, slots=True)
class CellGroup:
    """Cells that one relay serves; half of `bridge` runs next to it."""

    number: int
    need: Cell
    bridge: str | None
    cells: tuple[Cell, ...]


def schedule(plan: Plan) -> list[CellGroup]:
    groups = [group for number in range(1, plan.run.repeats + 1) for group in schedule_pass(plan, plan.cells, number)]
    return number_groups(groups)


def number_groups(groups: Iterable[CellGroup], first: int = 1) -> list[CellGroup]:
    return [replace(group, number=number) for number, group in enumerate(groups, first)]


def schedule_pass(plan: Plan, cells: Iterable[Cell], number: int) -> list[CellGroup]:
    groups = group_by_relay(plan, [replace(cell, repeat=number) for cell in cells])
    return _ORDERS[plan.run.order](groups, plan.run.seed, number)


def _shuffled(groups: list[CellGroup], seed: int, number: int) -> list[CellGroup]:
    chance = random.Random(f"{seed} {number}")  # noqa: S311 - an order, not a secret
    chance.shuffle(groups)
    return [replace(group, cells=tuple(chance.sample(group.cells, len(group.cells)))) for group in groups]


def _alternating(groups: list[CellGroup], seed: int, number: int) -> list[CellGroup]:
    """Shuffle an odd pass; run an even one backwards, so that a linear drift gives every cell the same mean."""
    shuffled = _shuffled(groups, seed, (number + 1) // 2)
    if number % 2:
        return shuffled
    return [replace(group, cells=group.cells[::-1]) for group in reversed(shuffled)]


_ORDERS: dict[Order, Callable[[list[CellGroup], int, int], list[CellGroup]]] = {
    Order.LISTED: lambda groups, _seed, _number: groups,
    Order.SHUFFLED: _shuffled,
    Order.ALTERNATING: _alternating,
}


def group_by_relay(plan: Plan, cells: Iterable[Cell]) -> list[CellGroup]:
    served: dict[tuple[Cell, str | None], list[Cell]] = {}
    for cell in cells:
        half = cell.bridge if plan.runs_halves(cell) else None
        served.setdefault((cell.relay, half), []).append(cell)
    return [
        CellGroup(number, need, bridge, tuple(listed))
        for number, ((need, bridge), listed) in enumerate(served.items(), 1)
    ]


@dataclass(frozen=True, slots=True)
class Remaining:
    seconds: float

    def __str__(self) -> str:
        minutes, seconds = divmod(round(self.seconds), 60)
        hours, minutes = divmod(minutes, 60)
        if hours:
            return f"{hours} h {minutes:02} min"
        return f"{minutes} min {seconds:02} s" if minutes else f"{seconds} s"


@dataclass(slots=True)
class Estimate:
    """Expected duration of runs: their schedules, and the overhead as measured so far."""

    plan: Plan
    _measured_s: list[float] = field(default_factory=list)

    def cell_seconds(self, cell: Cell) -> float:
        overhead_s = RUN_OVERHEAD_S + BRIDGE_OVERHEAD_S * cell.crosses_domains + start_lead_s(cell.senders)
        overhead_s += OWN_COST_S * self.plan.run.measures_own_cost(cell.repeat) + self.link_seconds(cell)
        if self._measured_s:
            overhead_s = sum(self._measured_s) / len(self._measured_s)
        return self.plan.run.planned_seconds(cell.rate, cell.outage) + overhead_s + self.plan.run.settle_seconds

    def link_seconds(self, cell: Cell) -> float:
        """Return what a lossy or full link adds; streams lose nothing."""
        link, run, slower = self.plan.link_of(cell), self.plan.run, cell.rate / carried_rate(self.plan, cell) - 1
        if link is None:
            return 0.0
        may_lose = slower > 0 or bool(link.loss_percent or link.outage_ms or link.file)
        later_s = max(run.planned_seconds(cell.rate, cell.outage) * slower, 0.0)
        return may_lose * loss_seconds(cell) + min(run.cutoff_seconds, later_s)

    def measured(self, cell: Cell, seconds: float) -> None:
        self._measured_s.append(max(0.0, seconds - self.plan.run.planned_seconds(cell.rate, cell.outage)))

    def remaining(self, cells: list[Cell]) -> Remaining:
        return Remaining(sum(self.cell_seconds(together[0]) for together in recorded_together(cells)))


def loss_seconds(cell: Cell) -> float:
    if not load_backend(cell.backend).speaks_dds and cell.transport != "udp":
        return 0.0
    is_large = cell.reliability == "reliable" and (cell.size or 0) > LARGE_BYTES
    is_slow = is_large and cell.backend == "ros2" and "cyclonedds" not in (cell.rmw or "")
    return SLOW_LOSS_S if is_slow else LOSS_OVERHEAD_S


def carried_rate(plan: Plan, cell: Cell) -> float:
    link = plan.link_of(cell)
    if link is None or not link.rate_mbit_s or not cell.size:
        return math.inf
    return link.rate_mbit_s * 1e6 / (8 * cell.size * (2 if link.shared else 1))


def plan_seconds(plan: Plan, *, passes: int | None = None, relay_starts: int | None = None) -> Remaining:
    passes = plan.run.repeats if passes is None else passes
    first_s = Estimate(plan).remaining(list(plan.cells)).seconds
    measuring = min(passes, plan.run.own_cost_passes or passes)
    further_s = first_s - OWN_COST_S * len(recorded_together(plan.cells))
    starts = passes * len(group_by_relay(plan, plan.cells)) if relay_starts is None else relay_starts
    return Remaining(measuring * first_s + (passes - measuring) * further_s + RELAY_OVERHEAD_S * starts)
