"""Middlewares that cells need and a device does not have."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from ...backends import load_backend
from ..plan.cells import Cell
from ..plan.commands import relay_arguments

if TYPE_CHECKING:
    from ..plan.plan import Plan
    from ..station.devices import RelayDevice

Middlewares: TypeAlias = "tuple[str, str, str | None, str, str | None, str | None]"
"""Environment, backend and RMW of the ping, backend and RMW of the relay, and the middleware's own configuration."""


def middlewares_of(cell: Cell) -> Middlewares:
    return cell.environment, cell.backend, cell.rmw, cell.relay.backend, cell.relay.rmw, cell.configuration


def missing_middlewares(plan: Plan, device: RelayDevice) -> dict[Middlewares, str]:
    reasons: dict[tuple[str, str | None, str | None, bool], str | None] = {}

    def reason_of(backend: str, rmw: str | None, middleware: str | None, *, is_remote: bool) -> str | None:
        key = backend, rmw, middleware, is_remote
        if key not in reasons:
            reasons[key] = None if is_remote else _missing_here(backend, rmw)
            # Only the middleware itself knows which keys it knows.
            if is_remote or (
                not reasons[key] and (middleware is not None or load_backend(backend).environment.sources())
            ):
                arguments = relay_arguments(plan, Cell(backend=backend, rmw=rmw, configuration=middleware))
                reasons[key] = device.rehearse(arguments)
        return reasons[key]

    missing = {}
    for needed in dict.fromkeys(map(middlewares_of, plan.cells)):
        environment, backend, rmw, relay_backend, relay_rmw, environment_name = needed
        if environment:
            continue
        relay = reason_of(relay_backend, relay_rmw, environment_name, is_remote=plan.has_two_devices)
        if reason := reason_of(backend, rmw, environment_name, is_remote=False) or relay:
            missing[needed] = reason
    return missing


def _missing_here(name: str, rmw: str | None) -> str | None:
    backend = load_backend(name)
    if not backend.find_installed():
        return f"{backend.label} is not here: {backend.install}"
    return backend.missing_rmw(rmw) if rmw is not None and backend.missing_rmw is not None else None
