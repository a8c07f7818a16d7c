"""The command lines of `dds-record` that a cell and its relay are recorded with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .cells import AXES, RELAY_AXES
from .plan import connects_to_relay

if TYPE_CHECKING:
    from .cells import Cell, RelayNeed
    from .plan import DeviceSettings, Plan
    from .schedule import Group


def relay_arguments(plan: Plan, need: RelayNeed) -> list[str]:
    """Arguments of the relay that serves every cell with this need, without `--out`."""
    return [
        *("--role", "relay", "--domain", str(plan.run.domain)),
        *_axis_arguments(need, [axis.name for axis in RELAY_AXES]),
        *_common_arguments(plan, plan.relay),
    ]


def half_arguments(plan: Plan, group: Group) -> list[str]:
    """Arguments of `dds-bridge` for the half of the group's bridge that runs beside its relay.

    It waits for the ping's half, which each ping starts anew: so nothing has to be found again between two cells.
    """
    assert group.bridge is not None
    need = group.need
    interface = "127.0.0.1" if plan.discovery == "localhost" else "0.0.0.0"  # noqa: S104 - the other device is outside
    return [
        *(group.bridge, "--half", "relay", "--listen", f"{interface}:{plan.relay.bridge_port}"),
        *("--from", str(plan.run.ping_domain), "--to", str(plan.run.domain), "--discovery", plan.discovery),
        *("--reliability", need.reliability, "--durability", need.durability, "--depth", str(need.depth)),
        *(["--tuned"] if need.tuned else []),
    ]


def ping_arguments(plan: Plan, cell: Cell, wait_s: float, relay_address: str | None) -> list[str]:
    """Arguments of the ping of this cell, without `--out`.

    Args:
        plan: what all cells have in common.
        cell: what this one has of its own.
        wait_s: how long it waits for an echo.
        relay_address: of the relay's device, None on one machine.
    """
    domain = plan.run.ping_domain if cell.crosses_domains else plan.run.domain
    return [
        *("--role", "ping", "--domain", str(domain)),
        *(("--relay-domain", str(plan.run.domain)) if cell.crosses_domains else ()),
        *_axis_arguments(cell, [axis for axis in AXES if axis not in ("relay_backend", "relay_rmw")]),
        *(("--bridge-peer", f"{relay_address}:{plan.relay.bridge_port}") if plan.runs_halves(cell) else ()),
        *(("--peer", relay_address) if relay_address and connects_to_relay(cell.backend) else ()),
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
