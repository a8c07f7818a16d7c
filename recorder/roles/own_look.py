"""What this process can see of itself where no echo comes: settings, interfaces and connections that cannot work."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress

import psutil

from ..applied.vendors import vendor_facts
from ..backends import load_backend
from ..backends.node import Node
from ..choices import Discovery
from ..kernel.sockets import Socket, read_sockets

_STUCK_SEGMENTS = 3
"""Segments of a connection that were sent again; a healthy one that just opened has none."""
_IP_MTU = 14
"""Socket option of <linux/in.h>, which `socket` lacks."""


def look_at_self(node: Node) -> Iterator[str]:
    """Yield, the surest first, what keeps messages of this process from arriving, with what to do."""
    backend, rmw = load_backend(node.middleware.backend), node.middleware.rmw
    sockets = read_sockets() or ()
    yield from backend.own_causes(node.options, rmw, os.environ)
    yield from _stuck_connections(sockets)
    if backend.speaks_dds and node.options.discovery is not Discovery.LOCALHOST:
        yield from _one_of_several_interfaces(node.middleware.vendor, sockets)


def _stuck_connections(sockets: Sequence[Socket]) -> Iterator[str]:
    for read in sockets:
        if read.tcp is not None and read.tcp.retransmitted >= _STUCK_SEGMENTS:
            mtu = _path_mtu(read)
            yield (
                f"the connection to {read.remote_address}:{read.remote_port} sent {read.tcp.retransmitted} segments again, and "
                f"{read.tcp.acked_bytes:,} bytes were acknowledged: the path loses packets, maybe those as large as its MTU{mtu}; "
                "try a smaller MTU of the interface"
            )


def _path_mtu(read: Socket) -> str:
    family = socket.AF_INET if read.family == "ipv4" else socket.AF_INET6
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect((read.remote_address, read.remote_port))
        return f" ({probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)} here)"
    return ""


def _one_of_several_interfaces(vendor: str, sockets: Sequence[Socket]) -> Iterator[str]:
    opened = {read.local_address for read in sockets if read.protocol == "udp"}
    stats = psutil.net_if_stats()
    names = {
        address.address: name
        for name, addresses in psutil.net_if_addrs().items()
        for address in addresses
        if address.family == socket.AF_INET and not address.address.startswith("127.") and stats[name].isup
    }
    used = {names[address] for address in opened & names.keys()}
    others = sorted({*names.values()} - used)
    if used and others:
        cure = vendor_facts(vendor).name_interface.format(others[0])
        yield (
            f"this process sends through the interface {', '.join(sorted(used))} only, and has {', '.join(others)}, too: name the one in "
            f"the other side's network{f', {cure}' if cure else ''}"
        )
