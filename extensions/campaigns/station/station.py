"""The station of a sweep: both roles on this machine, or the relay on another device."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from dds_trace.base.files import expand_home
from dds_trace.recorder.options import DEFAULT_WAIT_S
from dds_trace.recorder.security.keys import shared_keys

from ..folder import make_parts
from ..plan.plan import Plan
from .devices import LocalDevice, PrintedDevice, RelayDevice, SpreadDevice
from .namespaces import NamespacePair
from .programs import environment_program, local_program, missing_environment
from .ssh import SshDevice, folder_there

PERSON_WAIT_S = 3600.0


@dataclass(frozen=True, slots=True)
class Station:
    """Where the roles of a sweep run; programs inherit the folder's `lock`, `relay_address` is None on one machine."""

    ping_command: Sequence[str]
    device: RelayDevice
    lock: int | None = None
    wait_s: float = DEFAULT_WAIT_S
    relay_address: str | None = None
    pair: NamespacePair | None = None
    environments: Mapping[str, tuple[Sequence[str], RelayDevice]] = field(default_factory=dict)
    further: tuple[str, ...] = ()

    def within(self, environment: str) -> Station:
        if not environment:
            return self
        ping_command, device = self.environments[environment]
        return replace(self, ping_command=ping_command, device=device)


@contextmanager
def open_station(
    plan: Plan, folder: Path, lock: int | None, *, show: Callable[[str], None], command: Sequence[str] | None = None
) -> Iterator[Station]:
    """Yield the station of a plan; namespaces and link are removed after the block.

    `lock` is the folder's, None for a rehearsal; `show` prints a line for a person; `command` is `dds-record`.
    """
    recorder = list(command or local_program("dds-record"))
    parts = make_parts(folder)
    others = {
        environment: environment_program(expand_home(environment).absolute(), "dds-record")
        for environment in dict.fromkeys(cell.environment for cell in plan.cells)
        if environment and missing_environment(environment) is None
    }
    if plan.by_hand:
        yield Station(recorder, PrintedDevice(show), lock, PERSON_WAIT_S, plan.relay.reached_at)
        return
    if plan.relay.ssh is not None:
        devices = plan.hosts or (plan.relay,)
        ssh = [SshDevice(ssh_host, parts, folder_there(plan.name, folder)) for ssh_host in devices]
        further = tuple(ssh_host.reached_at or "" for ssh_host in devices[1:])
        device = SpreadDevice(ssh) if further else ssh[0]
        yield Station(recorder, device, lock, relay_address=plan.relay.reached_at, further=further)
        return
    with ExitStack() as stack:
        has_air = any((link := plan.link_of(cell)) is not None and link.shared for cell in plan.cells)
        hosts = max((cell.hosts for cell in plan.cells), default=1)
        pair = stack.enter_context(NamespacePair(plan.link, hosts, has_air=has_air)) if plan.namespaces else None
        keys = stack.enter_context(shared_keys({cell.security for cell in plan.cells}))
        ping_prefix, relay_prefixes = (
            (pair.ping.prefix, [relay.prefix for relay in pair.relays]) if pair else ([], [[]])
        )

        def both(program: Sequence[str]) -> tuple[Sequence[str], RelayDevice]:
            bridge = [*program[:-1], str(Path(program[-1]).with_name("dds-trace")), "bridge"]
            relays = [
                LocalDevice(parts, [*prefix, *keys, *program], lock, [*prefix, *bridge]) for prefix in relay_prefixes
            ]
            return [*ping_prefix, *keys, *program], SpreadDevice(relays) if len(relays) > 1 else relays[0]

        yield Station(
            *both(recorder),
            lock,
            relay_address=pair.relay.address if pair else None,
            pair=pair,
            environments={environment: both(program) for environment, program in others.items()},
            further=tuple(relay.address for relay in pair.relays[1:]) if pair else (),
        )
