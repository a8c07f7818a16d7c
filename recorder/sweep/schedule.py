"""In which order the cells of a plan run, grouped by the relay that serves them."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from recorder.sweep.plan import Order

if TYPE_CHECKING:
    from recorder.sweep.cells import Cell, RelayNeed
    from recorder.sweep.plan import Plan


@dataclass(frozen=True, slots=True)
class Group:
    """Cells that one relay serves without a restart, in the order in which they run.

    Attributes:
        need: what the relay is started with.
        bridge: of all the cells, where a half of it has to run beside the relay; else None.
    """

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
        served: dict[tuple[RelayNeed, str | None], list[Cell]] = {}
        for cell in plan.cells:
            beside_relay = cell.bridge if plan.relay.ssh and cell.crosses_domains else None
            served.setdefault((cell.relay, beside_relay), []).append(replace(cell, repeat=repeat))
        of_pass = list(served.items())
        if plan.run.order is Order.SHUFFLED:
            chance = random.Random(f"{plan.run.seed} {repeat}")  # noqa: S311 - an order, not a secret
            chance.shuffle(of_pass)
            for _, cells in of_pass:
                chance.shuffle(cells)
        groups += [Group(need, bridge, tuple(cells)) for (need, bridge), cells in of_pass]
    return groups
