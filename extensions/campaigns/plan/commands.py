"""The command lines that record a cell and its relay."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from dds_trace.recorder.choices import Load

from .cells import AXES, DEFAULTS, RELAY_AXES, Cell, environment_name
from .flows import ONLY_RELAY, RelayPlace, sender_cells
from .plan import DeviceSettings, Plan, connects_to_relay
from .schedule import CellGroup

PASS_LABEL = "pass"  # noqa: S105 - no password: the pass of a sweep
"""Label with the number of the pass, for comparisons pass by pass."""

AGAINST_LABEL = "against"


def relay_arguments(plan: Plan, need: Cell, number: int = 1, position: RelayPlace = ONLY_RELAY) -> list[str]:
    device = plan.hosts[position.host] if plan.hosts else plan.relay
    flows = plan.flows or [cell.flow for cell in sender_cells(need) if cell.flow]
    is_single = need.receivers == 1
    if need.hosts > 1 and device.name is None:
        device = replace(device, name=device.ssh or f"host-{position.host + 1}")
    return [
        *("--role", "relay", "--domain", str(plan.run.domain)),
        *_axis_arguments(need, RELAY_AXES),
        *(argument for flow in flows for argument in ("--flow", flow)),
        *(() if is_single else ("--relay-id", str(position.number))),
        *_common_arguments(plan, need, device, number, is_single=is_single),
    ]


def half_arguments(plan: Plan, group: CellGroup) -> list[str]:
    assert group.bridge is not None
    need = group.need
    interface = "127.0.0.1" if plan.discovery == "localhost" else "0.0.0.0"  # noqa: S104 - the other device is outside
    return [
        *(group.bridge, "--half", "relay", "--listen", f"{interface}:{plan.relay.bridge_port}"),
        *("--from", str(plan.run.ping_domain), "--to", str(plan.run.domain), "--discovery", plan.discovery),
        *("--reliability", need.reliability, "--durability", need.durability, "--depth", str(need.depth)),
        *(["--tuned"] if need.tuned else []),
    ]


def ping_arguments(
    plan: Plan, cell: Cell, wait_s: float, relay_address: str | None, further: Sequence[str] = ()
) -> list[str]:
    """Return the arguments of a cell's ping, without `--out`; addresses of relays are None and empty on one machine."""
    hosts = [relay_address, *further][: cell.hosts] if connects_to_relay(cell.backend) else []
    name = replace(cell, repeat=1).name
    partner = plan.partners.get(name)
    domain = plan.run.ping_domain if cell.crosses_domains else plan.run.domain
    link = plan.link_of(cell)
    fan_out = {"relays": cell.receivers, "hosts": cell.hosts, "pings": cell.pings, "topics": cell.topics}
    return [
        *("--role", "ping", "--domain", str(domain)),
        *(("--relay-domain", str(plan.run.domain)) if cell.crosses_domains else ()),
        *_axis_arguments(cell, [name for name in AXES if name not in ("relay_backend", "relay_rmw")]),
        *(("--bridge-peer", f"{relay_address}:{plan.relay.bridge_port}") if plan.runs_halves(cell) else ()),
        *(word for host in hosts if host for word in ("--peer", host)),
        *(("--load-to", relay_address) if relay_address and cell.load == Load.NETWORK.value else ()),
        *(("--duration", f"{plan.run.seconds:g}") if math.isinf(cell.rate) else ()),
        *(() if math.isinf(cell.rate) else ("--messages", str(plan.run.messages_at(cell.rate, cell.outage)))),
        *("--warmup", str(plan.run.warmup)),
        *("--wait", f"{wait_s:g}"),
        *("--label", f"sweep={plan.name}", "--label", f"cell={name}"),
        *("--label", f"{PASS_LABEL}={cell.repeat}"),
        *(("--label", f"{AGAINST_LABEL}={partner}") if partner else ()),
        *(("--setting", f"environment={environment_name(cell.environment)}") if cell.environment else ()),
        *(("--setting", f"configuration={Path(cell.configuration).stem}") if cell.configuration else ()),
        *(("--label", f"link={link}", "--setting", f"link={link.setting}") if link else ()),
        *(("--setting", f"queue={cell.queue}ms") if cell.queue else ()),
        *_outage_arguments(plan, cell),
        *(("--flow", cell.flow) if cell.flow and cell.pings == 1 else ()),
        *(("--setting", f"flow={cell.flow}") if cell.flow else ()),
        *(("--relays", str(cell.receivers)) if cell.receivers > 1 else ()),
        *(word for key, count in fan_out.items() if count > 1 for word in ("--setting", f"{key}={count}")),
        *(("--setting", f"with={'+'.join(cell.with_flows)}") if cell.with_flows else ()),
        *_common_arguments(plan, cell, plan.ping, cell.repeat, is_single=cell.senders == cell.receivers == 1),
    ]


def _outage_arguments(plan: Plan, cell: Cell) -> list[str]:
    kind = (
        ["--setting", f"outage_by={cell.outage_by}"] if cell.outage or cell.outage_by != DEFAULTS["outage_by"] else []
    )
    if not cell.outage:
        return kind
    patience_s = plan.run.outage_after_seconds + cell.outage + plan.run.outage_limit_seconds
    return [*kind, "--setting", f"outage={cell.outage:g}s", "--patience", f"{patience_s:g}"]


def _common_arguments(
    plan: Plan, cell: Cell, device: DeviceSettings, number: int, *, is_single: bool = True
) -> list[str]:
    device_name = ["--device", device.name] if device.name else []
    connectivity = plan.connectivity_of(cell)
    link = ["--connectivity", connectivity] if connectivity else []
    wire = ["--wire"] if plan.run.wire else []
    cost = [] if is_single and plan.run.measures_own_cost(number) else ["--no-own-cost"]
    return ["--discovery", plan.discovery, *link, *device_name, *wire, *cost, *device.options]


def _axis_arguments(parameters: Cell, names: Iterable[str]) -> list[str]:
    return [
        argument
        for name in names
        if AXES[name].option and getattr(parameters, name) != DEFAULTS[name]
        for argument in _option(AXES[name].option, getattr(parameters, name))
    ]


def _option(option: str, value: object) -> list[str]:
    if isinstance(value, bool):
        return [option]  # a flag, of a value that is not the default
    if value == math.inf:
        return [option, "max"]
    return [option, f"{value:g}" if isinstance(value, float) else str(value)]
