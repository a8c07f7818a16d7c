"""Differences between what a run requested and what its process really uses.

Only those without another explanation: a false one bars a run from answers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

from ..domains import domain_port_range
from ..kernel.sockets import Socket
from .applied import SHARED_MEMORY, UNKNOWN, Applied, Traffic, is_excluded, payload_path
from .asked import Asked
from .memory import SharedMemory
from .vendors import SEGMENT, TransportFacts, vendor_facts

KERNELS_PORT = 32_768
"""First port that Linux chooses itself, unless `net.ipv4.ip_local_port_range` says otherwise."""
GRANTED_PER_REQUESTED = 2
"""Linux grants twice the socket buffer that a program sets (socket(7))."""
LEAST_BUFFER_BYTES = 2304
"""Linux grants no less (SOCK_MIN_RCVBUF)."""


class Setting(Enum):
    TRANSPORT = "transport"
    TUNED = "tuned"
    PROFILE = "profile"
    INTERFACE = "interface"
    KERNEL_LIMIT = "kernel_limit"
    LARGE_DATA = "large_data"
    SHARED_MEMORY = "shared_memory"
    MEMORY_NAMESPACE = "memory_namespace"
    CONGESTION_CONTROL = "congestion_control"
    SECURITY = "security"
    PRIORITY = "priority"
    WHEN_FULL = "when_full"
    BUFFER = "buffer"
    SEGMENT = "segment"


@dataclass(frozen=True, slots=True)
class Difference:
    """A setting that was not applied; `words` is a sentence without a full stop."""

    setting: Setting
    asked: str
    applied: str
    words: str


def differences(requested: Asked, applied: Applied, traffic: Traffic | None = None) -> tuple[Difference, ...]:
    results = [rule(requested, applied, traffic) for rule in _RULES]
    return tuple(difference for difference in results if difference is not None)


def publisher_differences(requested: Mapping[str, str], used: Mapping[str, str]) -> tuple[Difference, ...]:
    return tuple(
        Difference(Setting(name), value, used[name], f"asked for {name} {value}, the publisher has {used[name]}")
        for name, value in requested.items()
        if name in used and used[name] != value
    )


def _transport(requested: Asked, applied: Applied, traffic: Traffic | None) -> Difference | None:
    facts = vendor_facts(requested.vendor).transports.get(requested.transport)
    if facts is None:
        return None
    used = _contradiction(facts, requested, applied, traffic)
    if used is None:
        return None
    if requested.profile:
        words = f"the profile {requested.profile} asks for {facts.label}, {used}"
        if facts.shared_memory is False:
            words += " (its transports are in addition to others unless useBuiltinTransports is false; ROS 2's LOCALHOST range adds its own)"
        return Difference(Setting.PROFILE, requested.profile, used, words)
    setting = Setting.LARGE_DATA if requested.transport == "large-data" else Setting.TRANSPORT
    return Difference(setting, requested.transport, used, f"asked for {facts.label}, {used}")


def _contradiction(facts: TransportFacts, requested: Asked, applied: Applied, traffic: Traffic | None) -> str | None:
    memory, sockets = _memory_of(requested, applied), applied.latest.sockets
    carrying = _carrying(applied)
    has_memory = applied.latest.memory is not None
    if facts.shared_memory is False and memory:
        if traffic is not None and payload_path(applied, traffic) == SHARED_MEMORY:
            return "the bytes went through shared memory"
        return f"shared memory is open ({_described(memory)})"
    if facts.shared_memory is True and has_memory and not memory:
        return "no shared memory is mapped"
    if (
        facts.protocol is not None
        and sockets is not None
        and not any(read.protocol == facts.protocol for read in carrying)
    ):
        return f"no {facts.protocol.upper()} socket is open"
    return None


def _receive_buffer(requested: Asked, applied: Applied, _traffic: Traffic | None) -> Difference | None:
    sockets = _sized_sockets(requested, applied)
    ports = domain_port_range(requested.domain_id)
    kernels_port = applied.latest.limits.get("net.ipv4.ip_local_port_range.min", KERNELS_PORT)
    in_domain = [read for read in sockets if read.local_port in ports and read.local_port < kernels_port]
    # A socket that only sends is not enlarged, and has a port that the kernel chose. If no port identifies the
    # receiving ones, the largest buffer counts.
    buffers = [read.receive_buffer_bytes for read in in_domain] or [
        max((read.receive_buffer_bytes for read in sockets), default=0)
    ]
    expected_bytes = GRANTED_PER_REQUESTED * requested.receive_buffer_bytes
    if requested.buffer_is_exact and sockets and min(buffers) > max(expected_bytes, LEAST_BUFFER_BYTES):
        words = f"asked for receive buffers that the kernel shows as {expected_bytes:,} bytes, and it shows {min(buffers):,}"
        return Difference(Setting.BUFFER, str(requested.receive_buffer_bytes), str(min(buffers)), words)
    return _buffer(
        "receive", "net.core.rmem_max", requested.receive_buffer_bytes, min(buffers) if sockets else None, applied
    )


def _segment(requested: Asked, applied: Applied, _traffic: Traffic | None) -> Difference | None:
    sizes = [file.size_bytes for file in _memory_of(requested, applied) if file.role == SEGMENT and file.is_own]
    requested_bytes = requested.segment_bytes
    if (
        requested.vendor != "fastdds"
        or not requested_bytes
        or not sizes
        or requested_bytes <= max(sizes) <= 2 * requested_bytes
    ):
        return None
    words = f"asked for a segment of {requested_bytes:,} bytes, the mapped one has {max(sizes):,}"
    return Difference(Setting.SEGMENT, str(requested_bytes), str(max(sizes)), words)


def _send_buffer(requested: Asked, applied: Applied, _traffic: Traffic | None) -> Difference | None:
    buffers = [read.send_buffer_bytes for read in _sized_sockets(requested, applied)]
    return _buffer("send", "net.core.wmem_max", requested.send_buffer_bytes, max(buffers, default=None), applied)


def _buffer(
    way: str, limit_name: str, requested_bytes: int, granted_bytes: int | None, applied: Applied
) -> Difference | None:
    expected_bytes = GRANTED_PER_REQUESTED * requested_bytes
    if not requested_bytes or granted_bytes is None or granted_bytes >= expected_bytes:
        return None
    words = (
        f"asked for {way} buffers of {requested_bytes:,} bytes, which the kernel shows as {expected_bytes:,}, "
        f"and it shows {granted_bytes:,}"
    )
    limit_bytes = applied.latest.limits.get(limit_name)
    if limit_bytes is not None and granted_bytes == GRANTED_PER_REQUESTED * limit_bytes:
        words += f": {limit_name} is {limit_bytes:,}"
        return Difference(Setting.KERNEL_LIMIT, str(requested_bytes), str(limit_bytes), words)
    return Difference(Setting.TUNED, str(expected_bytes), str(granted_bytes), words)


def _interface(requested: Asked, applied: Applied, traffic: Traffic | None) -> Difference | None:
    if not requested.interface or traffic is None or not is_excluded(applied, requested.interface, traffic):
        return None
    path = payload_path(applied, traffic)
    way = {UNKNOWN: "another way", SHARED_MEMORY: "through shared memory"}.get(path, f"through {path}")
    words = f"asked for the interface {requested.interface}, the bytes went {way}"
    return Difference(Setting.INTERFACE, requested.interface, path, words)


def _shared_memory(requested: Asked, applied: Applied, traffic: Traffic | None) -> Difference | None:
    if requested.shared_memory is None or applied.latest.memory is None:
        return None
    memory = _memory_of(requested, applied)
    path = UNKNOWN if traffic is None else payload_path(applied, traffic)
    if not requested.shared_memory and memory:
        used = "the bytes went through it" if path == SHARED_MEMORY else f"it is mapped ({_described(memory)})"
        return Difference(Setting.SHARED_MEMORY, "off", used, f"asked for no shared memory, {used}")
    if requested.shared_memory and not memory:
        used = "none is mapped"
        return Difference(Setting.SHARED_MEMORY, "on", used, f"asked for shared memory, {used}")
    if requested.shared_memory and path not in (UNKNOWN, SHARED_MEMORY):
        words = f"asked for shared memory, the bytes went through {path}: the other side's /dev/shm is another one, or it has shared memory off"
        return Difference(Setting.MEMORY_NAMESPACE, "on", path, words)
    return None


def _memory_namespace(requested: Asked, applied: Applied, traffic: Traffic | None) -> Difference | None:
    memory = _memory_of(requested, applied)
    elsewhere = [file.name for file in memory if not file.is_here]
    if elsewhere:
        words = f"{elsewhere[0]} is mapped, but it is not the file of that name in this process's /dev/shm"
        return Difference(Setting.MEMORY_NAMESPACE, requested.transport, elsewhere[0], words)
    # Fast DDS sends to a receiver of this host through the receiver's port in /dev/shm, and creates a missing port.
    # Nobody serves that one: the receiver serves the file of that name in its own mount namespace. Ports from 7000 on
    # belong to all domains of a machine, so only the domain's own count. A segment of a dead owner may be the
    # receiver's.
    in_vain = traffic is not None and traffic.sent > 0 and traffic.received == 0
    ports = domain_port_range(requested.domain_id)
    unserved = [file.name for file in memory if file.is_unserved_port and file.port_number in ports]
    if in_vain and unserved and not any(file.is_foreign_segment and not file.is_served for file in memory):
        words = (
            f"messages for a receiver on this host go to {unserved[0]} in /dev/shm, where nobody reads them: "
            "the other side has a /dev/shm of its own (a container?), or has just left; share it, or ask for UDP"
        )
        return Difference(Setting.MEMORY_NAMESPACE, requested.transport, unserved[0], words)
    return None


def _congestion_control(requested: Asked, applied: Applied, _traffic: Traffic | None) -> Difference | None:
    ports = domain_port_range(requested.domain_id)
    used = {
        read.tcp.congestion_control
        for read in applied.latest.sockets or ()
        if read.tcp is not None and (read.local_port in ports or read.remote_port in ports)
    }
    others = sorted(used - {requested.congestion_control, ""})
    if not requested.congestion_control or not others:
        return None
    words = f"asked for TCP by {requested.congestion_control}, a connection goes by {others[0]}"
    return Difference(Setting.CONGESTION_CONTROL, requested.congestion_control, others[0], words)


def _memory_of(requested: Asked, applied: Applied) -> list[SharedMemory]:
    memory = applied.latest.memory or ()
    return [file for file in memory if file.middleware == requested.vendor and file.is_in_use]


def _sized_sockets(requested: Asked, applied: Applied) -> list[Socket]:
    """Of UDP, or of TCP where both buffers were requested."""
    if requested.buffer_is_exact and requested.send_buffer_bytes:
        return [read for read in _carrying(applied) if read.tcp is not None]
    return [read for read in applied.latest.sockets or () if read.protocol == "udp"]


def _carrying(applied: Applied) -> list[Socket]:
    # A connection may end with the other side.
    return [*(applied.latest.sockets or ()), *(applied.begin.sockets or ())]


def _described(memory: list[SharedMemory]) -> str:
    segments = [file.size_bytes for file in memory if file.role == SEGMENT]
    return f"{len(memory)} files, {len(segments)} segments of {sum(segments):,} bytes"


_RULES: tuple[Callable[[Asked, Applied, Traffic | None], Difference | None], ...] = (
    _transport,
    _receive_buffer,
    _segment,
    _send_buffer,
    _interface,
    _shared_memory,
    _memory_namespace,
    _congestion_control,
)
