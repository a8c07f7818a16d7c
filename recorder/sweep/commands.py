"""The command lines of `dds-record` that a cell and its relay are recorded with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from recorder.sweep.cells import AXES, RELAY_AXES

if TYPE_CHECKING:
    from recorder.sweep.cells import Cell, RelayNeed
    from recorder.sweep.plan import DeviceSettings, Plan
    from recorder.sweep.schedule import Group

BRIDGE_PORT = 7447
"""Where the two halves of a bridge meet; Zenoh's own port, so that firewalls may know it."""


def relay_arguments(plan: Plan, need: RelayNeed) -> list[str]:
    """Arguments of the relay that serves every cell with this need, without `--out`."""
    return [
        *("--role", "relay", "--domain", str(plan.run.domain)),
        *_axis_arguments(need, [axis.name for axis in RELAY_AXES]),
        *_common_arguments(plan, plan.relay),
    ]


def half_arguments(plan: Plan, group: Group, half: str) -> list[str]:
    """Arguments of `dds-bridge` for the half of the group's bridge that runs beside its `ping` or its `relay`."""
    assert group.bridge is not None
    need = group.need
    meeting = (
        ["--listen", f"0.0.0.0:{BRIDGE_PORT}"]
        if half == "ping"
        else ["--peer", f"{plan.ping.address}:{BRIDGE_PORT}"]
    )
    return [
        *(group.bridge, "--half", half, *meeting),
        *("--from", str(plan.run.ping_domain), "--to", str(plan.run.domain), "--discovery", plan.discovery),
        *("--reliability", need.reliability, "--durability", need.durability, "--depth", str(need.depth)),
        *(["--tuned"] if need.tuned else []),
    ]


def ping_arguments(plan: Plan, cell: Cell, wait_s: float) -> list[str]:
    """Arguments of the ping of this cell, without `--out`; it waits so long for an echo."""
    domain = plan.run.ping_domain if cell.crosses_domains else plan.run.domain
    bridged = ["--relay-domain", str(plan.run.domain)] if cell.crosses_domains else []
    if plan.runs_halves(cell):
        bridged.append("--bridge-running")
    return [
        *("--role", "ping", "--domain", str(domain), *bridged),
        *_axis_arguments(cell, [axis for axis in AXES if axis not in ("relay_backend", "relay_rmw")]),
        *("--messages", str(plan.run.messages_at(cell.rate)), "--warmup", str(plan.run.warmup)),
        *("--wait", f"{wait_s:g}"),
        *("--label", f"sweep={plan.name}", "--label", f"cell={cell.name}"),
        *(("--label", f"link={plan.link}") if plan.link else ()),
        *_common_arguments(plan, plan.ping),
    ]


def _common_arguments(plan: Plan, device: DeviceSettings) -> list[str]:
    named = ["--device", device.name] if device.name else []
    link = ["--connectivity", plan.connectivity] if plan.connectivity else []
    return ["--discovery", plan.discovery, *link, *named, *device.options]


def _axis_arguments(parameters: Cell | RelayNeed, axes: list[str]) -> list[str]:
    """Options for what differs from the default: `dds-record`'s own defaults are the plan's as well."""
    return [
        argument
        for axis in axes
        if getattr(parameters, axis) != AXES[axis].default
        for argument in _option(AXES[axis].metadata["option"], getattr(parameters, axis))
    ]


def _option(option: str, value: Any) -> list[str]:
    if isinstance(value, bool):
        return [option] if value else []
    return [option, f"{value:g}" if isinstance(value, float) else str(value)]
