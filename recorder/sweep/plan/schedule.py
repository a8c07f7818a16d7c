"""In which order the cells of a plan run, grouped by the relay that serves them."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from .plan import Order

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .cells import Cell, RelayNeed
    from .plan import Plan


@dataclass(frozen=True, slots=True)
class Group:
    """Cells that one relay serves without a restart, in the order in which they run.

    Attributes:
        number: 1, 2 ... in the order in which they run.
        need: what the relay is started with.
        bridge: of all the cells, where one half of it runs beside the ping and one beside the relay; else None.
    """

    number: int
    need: RelayNeed
    bridge: str | None
    cells: tuple[Cell, ...]


def schedule(plan: Plan) -> list[Group]:
    """All cells of the plan, each once for each repeat.

    `shuffled` shuffles the relays of each pass and the cells of each relay, not all cells at once: a relay
    serves its cells without a restart, and two middlewares meet the machine's drift alike when there are
    several repeats. The order depends on the plan's seed alone, so an interrupted sweep goes on in it.
    """
    groups: list[Group] = []
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


def group_by_relay(plan: Plan, cells: Iterable[Cell]) -> list[Group]:
    """The cells by the relay that serves them, relays and cells in the order of their first appearance."""
    served: dict[tuple[RelayNeed, str | None], list[Cell]] = {}
    for cell in cells:
        beside_relay = cell.bridge if plan.runs_halves(cell) else None
        served.setdefault((cell.relay, beside_relay), []).append(cell)
    return [
        Group(number, need, bridge, tuple(listed))
        for number, ((need, bridge), listed) in enumerate(served.items(), 1)
    ]
