"""The command lines of `dds-record` that a cell and its relay are recorded with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from recorder.sweep.cells import AXES, RELAY_AXES

if TYPE_CHECKING:
    from recorder.sweep.cells import Cell, RelayNeed
    from recorder.sweep.plan import DeviceSettings, Plan


def relay_arguments(plan: Plan, need: RelayNeed) -> list[str]:
    """Arguments of the relay that serves every cell with this need, without `--out`."""
    return [
        *("--role", "relay", "--domain", str(plan.run.domain)),
        *_axis_arguments(need, [axis.name for axis in RELAY_AXES]),
        *_common_arguments(plan, plan.relay),
    ]


def ping_arguments(plan: Plan, cell: Cell, wait_s: float) -> list[str]:
    """Arguments of the ping of this cell, without `--out`; it waits so long for an echo."""
    domain = plan.run.ping_domain if cell.crosses_domains else plan.run.domain
    bridged = ["--relay-domain", str(plan.run.domain)] if cell.crosses_domains else []
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
    return ["--discovery", plan.discovery, "--connectivity", plan.connectivity, *named, *device.options]


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
