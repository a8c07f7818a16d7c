"""The rehearsal of a plan: which cells cannot be recorded."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from dds_trace.base.errors import OutputError, TraceError
from dds_trace.extensions.bridges.base import load_bridge
from dds_trace.recorder.options import DEFAULT_WAIT_S
from dds_trace.recorder.payloads import is_live

from .plan.cells import DEFAULTS, Cell
from .plan.commands import half_arguments, ping_arguments, relay_arguments
from .plan.plan import Plan
from .plan.schedule import CellGroup, group_by_relay
from .run.runner import Middlewares, middlewares_of, missing_here
from .run.state import SweepState
from .station.programs import missing_environment, rehearse_program
from .station.station import Station, open_station

CheckArguments = Callable[[Sequence[str]], None]
"""Function that raises an `OptionError` where `dds-record` would refuse its arguments."""

_TOO_OLD = "No such option: --check"


def check_plan(plan: Plan, folder: Path, check_arguments: CheckArguments) -> dict[str, str]:
    _check_folder(plan, folder)
    refused: dict[Cell, str] = {}
    not_here = cache(_not_here)  # of some middlewares, in thousands of cells
    for group in group_by_relay(plan, plan.cells):
        relay_reason = _refusal(check_arguments, relay_arguments(plan, group.need), folder)
        for cell in group.cells:
            further = [host.reached_at or "" for host in plan.hosts[1:]]
            arguments = ping_arguments(plan, cell, DEFAULT_WAIT_S, plan.relay.reached_at, further)
            reason = _refusal(check_arguments, arguments, folder)
            if reason is None and relay_reason is not None:
                reason = f"its relay: {relay_reason}"
            if reason is None:
                reason = not_here(middlewares_of(cell), cell.bridge, is_remote=plan.has_two_devices)
            if reason is not None:
                refused[cell] = reason
    return _of_all_repeats(plan, refused)


def _not_here(needed: Middlewares, bridge: str, *, is_remote: bool) -> str | None:
    environment, backend, rmw, relay_backend, relay_rmw, _ = needed
    if environment:
        return missing_environment(environment)
    reason = missing_here(backend, rmw) or (None if is_remote else missing_here(relay_backend, relay_rmw))
    if reason is None and bridge != DEFAULTS["bridge"] and load_bridge(bridge).find() is None:
        reason = f"{bridge} is not here: {load_bridge(bridge).install}"
    return reason


def _of_all_repeats(plan: Plan, refused: Mapping[Cell, str]) -> dict[str, str]:
    return {
        replace(cell, repeat=number).name: reason
        for number in range(1, plan.run.repeats + 1)
        for cell, reason in refused.items()
    }


def _refusal(check_arguments: CheckArguments, arguments: Sequence[str], folder: Path) -> str | None:
    try:
        check_arguments([*arguments, "--out", str(folder / "rehearsal.mcap")])
    except TraceError as err:
        return str(err)
    return None


def rehearse_plan(
    plan: Plan,
    folder: Path,
    check_arguments: CheckArguments,
    *,
    note: Callable[[str], None],
    command: Sequence[str] | None = None,
) -> dict[str, str]:
    """Return the cells that cannot be recorded here, with the reason (docs/how-to/sweep.md); `folder` is not made."""
    _check_folder(plan, folder)
    refused: dict[Cell, str] = {}
    with (
        tempfile.TemporaryDirectory(prefix="dds-trace-rehearsal-") as scratch,
        open_station(plan, Path(scratch), None, show=note, command=command) as station,
    ):
        station.device.check()
        rehearsal = _Rehearsal(plan, station, Path(scratch), check_arguments, note)
        for group in group_by_relay(plan, plan.cells):
            refused |= rehearsal.refused_cells(group)
    return _of_all_repeats(plan, refused)


def _check_folder(plan: Plan, folder: Path) -> None:
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise OutputError(f"{nearest}: not a folder that can be written; give another --out")
    SweepState(folder / "state.json", plan.name, plan.digest)


@dataclass(slots=True)
class _Rehearsal:
    plan: Plan
    station: Station
    scratch: Path
    check_arguments: CheckArguments
    note: Callable[[str], None]
    _reasons: dict[Cell, str | None] = field(default_factory=dict, init=False)  # of the pings that were started
    _too_old: set[str] = field(default_factory=set, init=False)  # environments

    def refused_cells(self, group: CellGroup) -> dict[Cell, str]:
        reasons = {
            cell: missing_environment(cell.environment) or self._refusal(self._ping_arguments(cell))
            for cell in group.cells
        }
        accepted = [cell for cell, reason in reasons.items() if reason is None]
        relay_reason = self._rehearse_relay(group) if accepted else None
        reasons |= {cell: relay_reason or self._rehearse_ping(cell) for cell in accepted}
        return {cell: reason for cell, reason in reasons.items() if reason is not None}

    def _rehearse_relay(self, group: CellGroup) -> str | None:
        arguments = relay_arguments(self.plan, group.need)
        reason = self._refusal(arguments)
        device = self.station.within(group.need.environment).device
        if reason is None:
            reason = self._unless_old(group.need.environment, device.rehearse(arguments))
        if reason is None and group.bridge is not None:
            reason = device.rehearse_half(half_arguments(self.plan, group))
        return None if reason is None else f"its relay: {reason}"

    def _rehearse_ping(self, cell: Cell) -> str | None:
        alike = replace(cell, rate=DEFAULTS["rate"], size=None)
        if alike not in self._reasons:
            sent = replace(cell, data="binary") if is_live(cell.data) else cell
            command = [*self.station.within(cell.environment).ping_command, *self._ping_arguments(sent)]
            reason = rehearse_program(command, self.scratch)
            self._reasons[alike] = self._unless_old(cell.environment, reason)
        return self._reasons[alike]

    def _ping_arguments(self, cell: Cell) -> list[str]:
        station = self.station
        return ping_arguments(self.plan, cell, station.wait_s, station.relay_address, station.further)

    def _refusal(self, arguments: Sequence[str]) -> str | None:
        return _refusal(self.check_arguments, arguments, self.scratch)

    def _unless_old(self, environment: str, reason: str | None) -> str | None:
        if reason is None or not environment or _TOO_OLD not in reason:
            return reason
        if environment not in self._too_old:
            self._too_old.add(environment)
            self.note(f"{environment}: its dds-record has no --check, so nothing was rehearsed with it")
        return None
