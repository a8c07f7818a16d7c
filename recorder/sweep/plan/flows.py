"""`[[flows]]`: several pings on one relay, each measured by itself, with each other one, and with all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

from dds_trace.base import limits

from .cells import AXES, SENDER_AXES, Key

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from .cells import Cell

MOST_FLOWS = 8
"""Most flows: each has a process of its own, and pairs grow with their square."""

MESSAGE_AXES = ("data", "size", "rate")

FLOW_KEYS: Mapping[str, Key] = {
    "name": Key("name of the flow", limits.FLOW_NAME, default_words="required"),
    **{name: AXES[name] for name in (*MESSAGE_AXES, *SENDER_AXES)},
}


@dataclass(frozen=True, slots=True)
class Flow:
    """One flow: its name, and its message as axes of a cell."""

    name: str
    message: Mapping[str, object]


def flow_cells(cell: Cell, flows: Sequence[Flow]) -> Iterator[Cell]:
    """Yield the cells of one setup: each flow by itself, every pair, and all."""
    sizes = dict.fromkeys((1, 2, len(flows)))
    for together in (chosen for size in sizes for chosen in combinations(flows, size)):
        for flow in together:
            with_flows = tuple(other.name for other in together if other is not flow)
            yield replace(cell, **flow.message, flow=flow.name, with_flows=with_flows)  # type: ignore[arg-type]  # checked values


def recorded_together(cells: Sequence[Cell]) -> list[list[Cell]]:
    """Group cells that are recorded at the same time, in the order of their first one."""
    groups: dict[Cell, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(cell.together, []).append(cell)
    return list(groups.values())
