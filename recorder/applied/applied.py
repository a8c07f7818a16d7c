"""What a process really uses at the start and the end of a run, and which path carried the payload: shared memory or an interface.

The path is by counters against payload x messages. Other programs' traffic counts too: too small a count refutes a path, a large one
proves nothing. If both paths could explain the counts, the path is `unknown`. Only the bytes of own open TCP connections prove.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ..kernel.counters import (
    LOOPBACK,
    InterfaceCounters,
    MulticastGroup,
    read_groups,
    read_interfaces,
    read_kernel_counters,
    read_limits,
    since,
)
from ..kernel.sockets import Socket, read_sockets
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

    def socket_drops(self) -> int | None:
        """Return the datagrams dropped at its open UDP sockets during the run; None before the end, or if unknown."""
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


SHARED_MEMORY, UNKNOWN = "shm", "unknown"

MIN_PAYLOAD_BYTES = 2_000_000
"""Less payload cannot be distinguished from discovery (0.7 MB in six seconds)."""
SURELY, POSSIBLY = 0.9, 0.5
"""Share of the payload from which on a count explains it, and below which it cannot."""
MIN_MESSAGES = 10
"""With fewer, too many may have been in flight at a snapshot."""
MOST_OVERHEAD = 4.0
"""More than this multiple of the payload is mostly others' (loopback counts each message twice)."""


@dataclass(frozen=True, slots=True)
class Traffic:
    sent: int
    received: int
    payload_bytes: int

    @property
    def sent_bytes(self) -> int:
        return self.sent * self.payload_bytes

    @property
    def received_bytes(self) -> int:
        return self.received * self.payload_bytes


def with_path(applied: Applied, traffic: Traffic) -> Applied:
    return replace(applied, path=payload_path(applied, traffic))


def payload_path(applied: Applied, traffic: Traffic) -> str:
    if applied.end is None or traffic.sent_bytes + traffic.received_bytes < MIN_PAYLOAD_BYTES:
        return UNKNOWN
    most = MOST_OVERHEAD * (traffic.sent_bytes + traffic.received_bytes)
    explaining = [
        name
        for name, delta in interface_deltas(applied).items()
        if _reaches(delta, traffic) and delta.sent_bytes + delta.received_bytes <= most
    ]
    over_tcp = tcp_delta(applied)
    if over_tcp is not None and _reaches(over_tcp, traffic):
        connected = [read for read in applied.end.sockets or () if read.tcp is not None and read.remote_port]
        if all(read.is_local for read in connected):
            return LOOPBACK
        return explaining[0] if len(explaining) == 1 else UNKNOWN
    memory = [file for file in applied.end.memory or () if file.is_in_use]
    interfaces = applied.begin.interfaces
    if memory and interfaces and all(is_excluded(applied, name, traffic) for name in interfaces):
        return SHARED_MEMORY
    # Memory of another or an unknown process could explain the payload as well. On one machine own memory could too:
    # its reader may be gone, and other programs count on loopback.
    if any(file.is_own is not True for file in memory):
        explaining = []
    elif memory and explaining in ([], [LOOPBACK]):
        explaining = [LOOPBACK] if _only_loopback_is_left(applied, traffic) else []
    return explaining[0] if len(explaining) == 1 else UNKNOWN


def _only_loopback_is_left(applied: Applied, traffic: Traffic) -> bool:
    """Return whether messages came, at both snapshots no memory of others was mapped, and no other interface had enough bytes."""
    mapped = [*(applied.begin.memory or ()), *(applied.latest.memory or ())]
    possible = [name for name in applied.begin.interfaces if not is_excluded(applied, name, traffic)]
    return traffic.received >= MIN_MESSAGES and possible == [LOOPBACK] and all(file.is_own is True for file in mapped)


def interface_deltas(applied: Applied) -> dict[str, InterfaceCounters]:
    if applied.end is None:
        return {}
    return {
        name: since(counters, applied.begin.interfaces.get(name)) for name, counters in applied.end.interfaces.items()
    }


def is_excluded(applied: Applied, interface: str, traffic: Traffic) -> bool:
    """Return whether an interface received too little to have carried the payload; what was sent may be for nobody."""
    if applied.end is None or traffic.received < MIN_MESSAGES or traffic.received_bytes < MIN_PAYLOAD_BYTES / 2:
        return False
    delta = interface_deltas(applied).get(interface)
    if delta is None:  # never there; one that went away took its count along
        return interface not in applied.begin.interfaces
    # A negative count was reset.
    return 0 <= delta.received_bytes < POSSIBLY * traffic.received_bytes


def _reaches(delta: InterfaceCounters, traffic: Traffic) -> bool:
    return delta.sent_bytes >= SURELY * traffic.sent_bytes and delta.received_bytes >= SURELY * traffic.received_bytes


def tcp_delta(applied: Applied) -> InterfaceCounters | None:
    if applied.end is None or applied.end.sockets is None or applied.begin.sockets is None:
        return None
    before = {read.inode: read.tcp for read in applied.begin.sockets if read.tcp is not None}
    states = [(before.get(read.inode), read.tcp) for read in applied.end.sockets if read.tcp is not None]
    if not states:
        return None
    return InterfaceCounters(
        sum(now.acked_bytes - (then.acked_bytes if then else 0) for then, now in states),
        sum(now.received_bytes - (then.received_bytes if then else 0) for then, now in states),
    )
