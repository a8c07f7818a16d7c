"""Several pings and relays at once: `[[flows]]`, and fan-out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

from dds_trace.base import limits
from dds_trace.recorder.roles.ping import MAX_RELAYS

from .cells import AXES, SENDER_AXES, Cell, Key
from .plan import Plan, connects_to_relay

MOST_FLOWS = 8
"""Most flows: each has a process of its own, and pairs grow with their square."""

MESSAGE_AXES = ("data", "size", "rate")

FLOW_KEYS: Mapping[str, Key] = {
    "name": Key("name of the flow", limits.FLOW_NAME, default_words="required"),
    **{name: AXES[name] for name in (*MESSAGE_AXES, *SENDER_AXES)},
}


@dataclass(frozen=True, slots=True)
class Flow:
    name: str
    message: Mapping[str, object]


def flow_cells(cell: Cell, flows: Sequence[Flow]) -> Iterator[Cell]:
    sizes = dict.fromkeys((1, 2, len(flows)))
    for together in (chosen for size in sizes for chosen in combinations(flows, size)):
        for flow in together:
            with_flows = tuple(other.name for other in together if other is not flow)
            yield replace(cell, **flow.message, flow=flow.name, with_flows=with_flows)  # type: ignore[arg-type]  # checked values


def sender_cells(cell: Cell) -> Iterator[Cell]:
    name, count = ("p", cell.pings) if cell.pings > 1 else ("t", cell.topics)
    for number in range(1, count + 1):
        yield replace(cell, flow=f"{name}{number}") if count > 1 else cell


class RelayPlace(NamedTuple):
    """One of the relays of a cell: its number from 1 on, its `relay_id` among several, and its host from 0 on."""

    number: int
    host: int


ONLY_RELAY = RelayPlace(1, 0)


def relay_places(need: Cell) -> list[RelayPlace]:
    return [RelayPlace(number + 1, number // need.relays) for number in range(need.receivers)]


def is_crowded(cell: Cell) -> bool:
    return cell.receivers * cell.pings * cell.topics > 1


def fan_out_faults(plan: Plan) -> Iterator[tuple[bool, str]]:
    crowded = [cell for cell in plan.cells if is_crowded(cell)]
    most, hosts = max((cell.hosts for cell in plan.cells), default=1), len(plan.hosts)
    alone = next((cell.backend for cell in crowded if cell.relays > 1 and connects_to_relay(cell.backend)), "")
    is_mixed = plan.by_hand or bool(plan.flows)
    yield (
        bool(crowded)
        and (is_mixed or any(cell.crosses_domains or cell.outage or cell.environment for cell in crowded)),
        "relays, hosts, pings and topics are measured in one domain; remove bridge, outage, environment, [[flows]] or --print",
    )
    yield (
        any(cell.receivers > MAX_RELAYS or 1 not in (cell.pings, cell.topics) for cell in crowded),
        f"a ping meets at most {MAX_RELAYS} relays (relays times hosts), and each topic has one; give fewer, or one of pings and topics",
    )
    yield (
        bool(alone),
        f"the backend {alone} has one relay on a host, with the port of the domain; give hosts in place of relays",
    )
    yield (
        most > 1 and (plan.link is not None or (most > hosts if hosts else not plan.namespaces)),
        f"hosts = {most} needs as many [[devices]] (here {hosts}), or [network] namespaces = true and no [link]",
    )
    yield (
        len({host.name or host.ssh for host in plan.hosts if host.ssh}) < hosts,
        "each of [[devices]] needs ssh and a name of its own, by which results name it",
    )


def recorded_together(cells: Sequence[Cell]) -> list[list[Cell]]:
    groups: dict[object, list[Cell]] = {}
    for index, cell in enumerate(cells):
        groups.setdefault(cell.together if cell.senders > 1 else index, []).append(cell)
    return list(groups.values())
