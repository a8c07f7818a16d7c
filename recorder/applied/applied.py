"""`Applied`: what a process really uses, read from the kernel at the beginning of a run and at its end."""

from __future__ import annotations

import time
from collections.abc import Mapping  # noqa: TC003 - `from_json` looks the types of the fields up
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from .counters import (
    InterfaceCounters,
    MulticastGroup,
    read_groups,
    read_interfaces,
    read_kernel_counters,
    read_limits,
)
from .libraries import Library, read_libraries
from .memory import SharedMemory, read_memory
from .records import from_json, to_json
from .sockets import Socket, read_sockets

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import JsonObject


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one process uses at one instant.

    Attributes:
        monotonic_ns: when it was read.
        read_ns: how long reading took.
        sockets: UDP and TCP sockets of the process, None where the kernel tells nothing of them.
        groups: multicast groups of its network namespace.
        memory: shared memory that it maps and that a middleware made, None where that is unknown.
        libraries: middleware libraries that it has loaded.
        interfaces: interface -> totals of its network namespace.
        counters: kernel totals of lost fragments and datagrams, by name.
        limits: kernel settings that bound buffers and reassembly, by name.
    """

    monotonic_ns: int = 0
    read_ns: int = 0
    sockets: tuple[Socket, ...] | None = None
    groups: tuple[MulticastGroup, ...] = ()
    memory: tuple[SharedMemory, ...] | None = None
    libraries: tuple[Library, ...] = ()
    interfaces: Mapping[str, InterfaceCounters] = field(default_factory=dict)
    counters: Mapping[str, int] = field(default_factory=dict)
    limits: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Applied:
    """What one side of a run really uses.

    Attributes:
        begin: before the first message.
        end: after the last one, None until then.
        path: what carried the payload: `shm`, the name of an interface, or `unknown` (`carried.payload_path`).
    """

    begin: Snapshot
    end: Snapshot | None = None
    path: str = "unknown"

    @property
    def latest(self) -> Snapshot:
        """The snapshot at the end if there is one, else that at the beginning."""
        return self.begin if self.end is None else self.end

    def to_json(self) -> JsonObject:
        """Return the JSON object of the session's field `applied`."""
        return to_json(self)

    @classmethod
    def from_json(cls, data: JsonObject) -> Applied:
        """Return what `to_json` wrote; fields that this version does not know are skipped.

        Raises:
            TypeError: `data` has no `begin`.
        """
        return from_json(cls, data)

    def socket_drops(self) -> int | None:
        """Return the datagrams that the kernel dropped at the own sockets during the run.

        None before the end, and where sockets are unknown. A socket that was closed before the end counts nothing.
        """
        if self.end is None or self.end.sockets is None or self.begin.sockets is None:
            return None
        before = {each.inode: each.dropped for each in self.begin.sockets}
        return sum(each.dropped - before.get(each.inode, 0) for each in self.end.sockets)


def read_snapshot(pid: int | None = None) -> Snapshot:
    """Return what a process uses now; the calling process by default, or another of the same namespaces."""
    began_ns = time.monotonic_ns()
    snapshot = Snapshot(
        monotonic_ns=began_ns,
        sockets=read_sockets(pid),
        groups=read_groups(),
        memory=read_memory(pid),
        libraries=read_libraries(pid),
        interfaces=read_interfaces(),
        counters=read_kernel_counters(),
        limits=read_limits(),
    )
    return replace(snapshot, read_ns=time.monotonic_ns() - began_ns)


def read_applied(begun: Applied | None = None, pid: int | None = None) -> Applied:
    """Return what a process really uses: at the beginning of a run, or with `begun` at its end too.

    Args:
        begun: what was read at the beginning.
        pid: another process of the same namespaces (a bridge), the calling one by default.
    """
    snapshot = read_snapshot(pid)
    return Applied(snapshot) if begun is None else replace(begun, end=snapshot)
