"""Counters, limits, multicast groups and bound ports of a network namespace (/proc), other programs' traffic included."""

from __future__ import annotations

import fcntl
import socket
import struct
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Counters = TypeVar("Counters", bound="DataclassInstance")

PROC = Path("/proc")
LOOPBACK = "lo"
_KERNEL_JOINS = ("224.0.0.1", "ff01::1", "ff02::1")
"""Groups that the kernel joins on every interface."""

_FRAGMENT_COUNTERS = ("ReasmTimeout", "ReasmReqds", "ReasmOKs", "ReasmFails", "FragOKs", "FragFails", "FragCreates")
_UDP_COUNTERS = ("InErrors", "RcvbufErrors", "SndbufErrors", "InCsumErrors", "MemErrors")

_LIMITS = {
    "net.core.rmem_max": "net/core/rmem_max",
    "net.core.rmem_default": "net/core/rmem_default",
    "net.core.wmem_max": "net/core/wmem_max",
    "net.core.wmem_default": "net/core/wmem_default",
    "net.ipv4.ipfrag_time": "net/ipv4/ipfrag_time",
    "net.ipv4.ipfrag_high_thresh": "net/ipv4/ipfrag_high_thresh",
    "net.ipv4.ipfrag_low_thresh": "net/ipv4/ipfrag_low_thresh",
    "net.ipv4.ipfrag_max_dist": "net/ipv4/ipfrag_max_dist",
    "net.ipv4.ip_local_port_range.min": "net/ipv4/ip_local_port_range",  # the first of two numbers
}


@dataclass(frozen=True, slots=True)
class InterfaceCounters:
    sent_bytes: int = 0
    received_bytes: int = 0
    sent_packets: int = 0
    received_packets: int = 0


def ask_interface(interface: str, request: int) -> int:
    # Not from /sys/class/net: after `nsenter --net` it still shows the previous namespace's interfaces.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        answer = fcntl.ioctl(any_socket, request, struct.pack("16s16x", interface.encode()))
    number: int = struct.unpack_from("H", answer, 16)[0]
    return number


def since(record: Counters, before: Counters | None, *counters: str) -> Counters:
    """Return the record with its counters (all fields if none is named) since `before`; itself if there was none before."""
    if before is None:
        return record
    names = counters or tuple(field.name for field in fields(record))
    return replace(record, **{name: getattr(record, name) - getattr(before, name) for name in names})


@dataclass(frozen=True, slots=True)
class MulticastGroup:
    interface: str
    address: str


def read_interfaces(root: Path = PROC) -> dict[str, InterfaceCounters]:
    counters = {}
    for line in _lines(root / "self/net/dev")[2:]:
        name, _, remainder = line.partition(":")
        numbers = [int(number) for number in remainder.split()]
        if len(numbers) >= 10:
            counters[name.strip()] = InterfaceCounters(numbers[8], numbers[0], numbers[9], numbers[1])
    return counters


def read_kernel_counters(root: Path = PROC) -> dict[str, int]:
    """Return lost fragments and datagrams from the lines of IP and UDP in `/proc/net/snmp`; others have the same names."""
    names_of = {"Ip:": _FRAGMENT_COUNTERS, "Udp:": _UDP_COUNTERS}
    counters: dict[str, int] = {}
    rows = [line.split() for line in _lines(root / "self/net/snmp")]
    for names, values in zip(rows[::2], rows[1::2], strict=False):
        counters |= {
            name: int(value) for name, value in zip(names, values, strict=False) if name in names_of.get(names[0], ())
        }
    return counters


def read_limits(root: Path = PROC) -> dict[str, int]:
    """Return settings in bytes, except `net.ipv4.ipfrag_time` (s), `ipfrag_max_dist` (fragments) and the kernel's first port."""
    words = {name: " ".join(_lines(root / "sys" / path)).split() for name, path in _LIMITS.items()}
    return {name: int(values[0]) for name, values in words.items() if values and values[0].isdigit()}


def read_groups(root: Path = PROC) -> tuple[MulticastGroup, ...]:
    groups = _ipv4_groups(root / "self/net/igmp")
    for row in map(str.split, _lines(root / "self/net/igmp6")):
        if len(row) > 2:
            groups.append(MulticastGroup(row[1], socket.inet_ntop(socket.AF_INET6, bytes.fromhex(row[2]))))
    joined = [group for group in set(groups) if group.address not in _KERNEL_JOINS]
    return tuple(sorted(joined, key=lambda group: (group.interface, group.address)))


def _ipv4_groups(path: Path) -> list[MulticastGroup]:
    groups, interface = [], ""
    for line in _lines(path)[1:]:
        words = line.split()
        if not line[:1].isspace():
            interface = words[1].rstrip(":")
        elif words:
            # Printed as one number: its bytes in memory are the address in network order.
            address = socket.inet_ntop(socket.AF_INET, struct.pack("=I", int(words[0], 16)))
            groups.append(MulticastGroup(interface, address))
    return groups


def bound_udp_ports(root: Path = PROC) -> set[int]:
    rows = [line.split() for name in ("udp", "udp6") for line in _lines(root / "net" / name)[1:]]
    return {int(row[1].rpartition(":")[2], 16) for row in rows}


def ephemeral_ports(root: Path = PROC) -> range:
    numbers = " ".join(_lines(root / "sys/net/ipv4/ip_local_port_range")).split()
    return range(int(numbers[0]), int(numbers[1]) + 1) if len(numbers) > 1 else range(0)


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except OSError:  # another system, or no such protocol here
        return []
