"""Sockets of one process: addresses, granted buffers, drops, and the state of TCP."""

from __future__ import annotations

import errno
import os
import re
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path

from .diag import CONGESTION, INFO, MEMORY, DiagError, DiagSocket, dump_sockets, tcp_info_fields

_LISTEN = 10
_FAMILIES = {"ipv4": socket.AF_INET, "ipv6": socket.AF_INET6}
_PROTOCOLS = {"udp": socket.IPPROTO_UDP, "tcp": socket.IPPROTO_TCP}

# enum sk_meminfo_vars of <linux/sock_diag.h>, 32-bit numbers.
_RECEIVE_BUFFER, _SEND_BUFFER, _DROPS = 1, 3, 8

_TCP_FIELDS = {
    # field -> (format, offset in struct tcp_info)
    "rtt_us": ("=I", 68),
    "congestion_window": ("=I", 80),
    "retransmitted": ("=I", 100),
    "acked_bytes": ("=Q", 120),
    "received_bytes": ("=Q", 128),
}


@dataclass(frozen=True, slots=True)
class TcpState:
    """State of a TCP connection: the kernel's smoothed round-trip time, and totals since it was made."""

    congestion_control: str = ""
    rtt_us: int = 0
    congestion_window: int = 0
    retransmitted: int = 0
    acked_bytes: int = 0
    received_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Socket:
    """One UDP or TCP socket of the process.

    Attributes:
        remote_address, remote_port: `0.0.0.0` and 0 if it is not connected.
        receive_buffer_bytes: SO_RCVBUF as the kernel granted it: for a buffer that a program set, twice what it set,
            or twice `net.core.rmem_max` if that is less (socket(7)).
        dropped: datagrams that the kernel dropped at this socket since it was opened.
        tcp: state of a TCP connection, None for UDP and for a listening socket.
    """

    protocol: str
    family: str
    local_address: str
    local_port: int
    remote_address: str
    remote_port: int
    receive_buffer_bytes: int
    send_buffer_bytes: int
    dropped: int = 0
    inode: int = 0
    is_listening: bool = False
    tcp: TcpState | None = None

    @property
    def is_local(self) -> bool:
        return self.remote_port > 0 and ip_address(self.remote_address).is_loopback


def read_sockets(pid: int | None = None) -> tuple[Socket, ...] | None:
    """Return the UDP and TCP sockets of a process of this network namespace, by protocol, family and local port.

    None if the kernel does not answer or the process may not be inspected.
    """
    sockets = []
    try:
        inodes = _socket_inodes(os.getpid() if pid is None else pid)
        for protocol, protocol_number in _PROTOCOLS.items():
            for family, family_number in _FAMILIES.items():
                dumped = dump_sockets(family_number, protocol_number)
                sockets += [_socket(protocol, family, entry) for entry in dumped if entry.inode in inodes]
    except OSError:  # a DiagError is one
        return None
    return tuple(sorted(sockets, key=lambda read: (read.protocol, read.family, read.local_port, read.remote_port)))


def _socket_inodes(pid: int) -> set[int]:
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            if match := re.fullmatch(r"socket:\[(\d+)\]", str(descriptor.readlink())):
                inodes.add(int(match[1]))
    return inodes


def _socket(protocol: str, family: str, dumped: DiagSocket) -> Socket:
    memory = dumped.attributes.get(MEMORY, b"")
    numbers = struct.unpack_from(f"={len(memory) // 4}I", memory)
    if len(numbers) <= _SEND_BUFFER:
        raise DiagError(errno.ENODATA, "the kernel reports no buffer sizes")
    is_listening = protocol == "tcp" and dumped.state == _LISTEN
    return Socket(
        protocol,
        family,
        *dumped.local,
        *dumped.remote,
        receive_buffer_bytes=numbers[_RECEIVE_BUFFER],
        send_buffer_bytes=numbers[_SEND_BUFFER],
        dropped=numbers[_DROPS] if len(numbers) > _DROPS else 0,  # since Linux 4.6
        inode=dumped.inode,
        is_listening=is_listening,
        tcp=_tcp_state(dumped) if protocol == "tcp" and not is_listening else None,
    )


def _tcp_state(dumped: DiagSocket) -> TcpState:
    congestion_control = dumped.attributes.get(CONGESTION, b"").rstrip(b"\0").decode("ascii", "replace")
    return TcpState(congestion_control, **tcp_info_fields(dumped.attributes.get(INFO, b""), _TCP_FIELDS))
