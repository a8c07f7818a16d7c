"""What a process really uses at the start and the end of a run."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from dds_trace.tracefile.format.json_fields import JsonObject

from ..kernel.counters import (
    InterfaceCounters,
    MulticastGroup,
    read_groups,
    read_interfaces,
    read_kernel_counters,
    read_limits,
)
from ..kernel.sockets import Socket, read_sockets
from ..records import to_json
from .memory import Library, SharedMemory, read_libraries, read_memory


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one process uses (None: unknown), and the totals, limits and groups of its network namespace, at one instant."""

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
    """What one side of a run really uses, before its first message and after its last, and the payload's path."""

    begin: Snapshot
    end: Snapshot | None = None
    path: str = "unknown"

    @property
    def latest(self) -> Snapshot:
        return self.begin if self.end is None else self.end

    def to_json(self) -> JsonObject:
        return to_json(self)

    def socket_drops(self) -> int | None:
        """Return the datagrams dropped at the process's own UDP sockets during the run; None before the end, and if unknown.

        A socket that was closed before the end counts nothing.
        """
        if self.end is None or self.end.sockets is None or self.begin.sockets is None:
            return None
        before = {socket.inode: socket.dropped for socket in self.begin.sockets}
        return sum(
            socket.dropped - before.get(socket.inode, 0) for socket in self.end.sockets if socket.protocol == "udp"
        )


def read_snapshot(pid: int | None = None) -> Snapshot:
    start_ns = time.monotonic_ns()
    snapshot = Snapshot(
        monotonic_ns=start_ns,
        sockets=read_sockets(pid),
        groups=read_groups(),
        memory=read_memory(pid),
        libraries=read_libraries(pid),
        interfaces=read_interfaces(),
        counters=read_kernel_counters(),
        limits=read_limits(),
    )
    return replace(snapshot, read_ns=time.monotonic_ns() - start_ns)


def read_applied(started: Applied | None = None, pid: int | None = None) -> Applied:
    snapshot = read_snapshot(pid)
    return Applied(snapshot) if started is None else replace(started, end=snapshot)
