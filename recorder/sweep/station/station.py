"""Sets up where a plan's two roles run: here, in two namespaces, or with the relay on another device."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from ..run.runner import PARTS, Station
from .devices import LocalDevice, PrintedDevice, SshDevice
from .namespaces import NamespacePair
from .programs import local_program

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from ..plan.plan import Plan

ECHO_WAIT_S = 20.0
PERSON_WAIT_S = 3600.0
"""For a person to start the relay on the other device."""


@contextmanager
def open_station(
    plan: Plan,
    folder: Path,
    held: int,
    *,
    show: Callable[[str], None],
    command: Sequence[str] | None = None,
) -> Iterator[Station]:
    """The station of a plan while the block runs.

    Args:
        plan: says where the relay is and what is between the roles.
        folder: of the sweep.
        held: the lock of the folder.
        show: prints a line, such as a command that a person is to start.
        command: `dds-record` on this machine, the installed one unless given.

    Raises:
        OptionError, BackendUnavailableError: as `NamespacePair`.
    """
    own = list(command or local_program("dds-record"))
    parts = folder / PARTS
    if plan.by_hand:
        yield Station(own, PrintedDevice(show), held, PERSON_WAIT_S, plan.relay.reached_at)
    elif plan.relay.ssh is not None:
        yield Station(own, SshDevice(plan.relay, parts, plan.name), held, ECHO_WAIT_S, plan.relay.reached_at)
    elif plan.namespaces:
        with ExitStack() as stack:
            pair = stack.enter_context(NamespacePair(plan.link))
            relay = LocalDevice(parts, [*pair.relay.prefix, *own], held)
            yield Station(
                [*pair.ping.prefix, *own], relay, held, ECHO_WAIT_S, pair.relay.address, pair.measure
            )
    else:
        yield Station(own, LocalDevice(parts, own, held), held, ECHO_WAIT_S)
