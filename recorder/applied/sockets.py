"""Sockets of one process: addresses, granted buffers, drops, and how TCP fares, all as the kernel reports them."""

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

from .diag import CONGESTION, INFO, MEMORY, DiagError, DiagSocket, dump_sockets

_LISTEN = 10
_FAMILIES = {"ipv4": socket.AF_INET, "ipv6": socket.AF_INET6}
_PROTOCOLS = {"udp": socket.IPPROTO_UDP, "tcp": socket.IPPROTO_TCP}

# enum sk_meminfo_vars of <linux/sock_diag.h>: 32-bit numbers in this order.
_RECEIVE_BUFFER, _SEND_BUFFER, _DROPS = 1, 3, 8

# Offsets in struct tcp_info of <linux/tcp.h>, which only ever grows at its end.
_TCP_RTT_US, _TCP_CWND, _TCP_RETRANSMITTED = 68, 80, 100
_TCP_ACKED, _TCP_RECEIVED = 120, 128


@dataclass(frozen=True, slots=True)
class TcpState:
    """How one TCP connection fares.

    Attributes:
        congestion_control: name of the algorithm, `cubic` for example.
        rtt_us: smoothed round-trip time that TCP itself measures.
        congestion_window: segments that may be under way.
        retransmitted: segments sent again since the connection was made.
        acked_bytes: bytes that the other side acknowledged since then.
        received_bytes: bytes received since then.
    """

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
        protocol: `udp` or `tcp`.
        family: `ipv4` or `ipv6`.
        local_address: address that it is bound to, `0.0.0.0` for any.
        local_port: port that it is bound to.
        remote_address: address that it is connected to, `0.0.0.0` if it is not.
        remote_port: port that it is connected to, 0 if it is not.
        receive_buffer_bytes: SO_RCVBUF as the kernel granted it: for a buffer that a program set, twice what it set,
            or twice `net.core.rmem_max` if that is less (socket(7)).
        send_buffer_bytes: SO_SNDBUF likewise, bounded by `net.core.wmem_max`.
        dropped: datagrams that the kernel dropped at this socket since it was opened.
        inode: number that tells a socket from others while it is open.
        is_listening: waits for TCP connections.
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
        """Whether the other end of the connection is a loopback address."""
        return self.remote_port > 0 and ip_address(self.remote_address).is_loopback


def read_sockets(pid: int | None = None) -> tuple[Socket, ...] | None:
    """Return the UDP and TCP sockets of a process, ordered by protocol, family and local port.

    Args:
        pid: a process of this network namespace, the calling one by default.

    Returns:
        None where the kernel does not answer over sock_diag or the process cannot be looked at: nothing is known.
    """
    read = []
    try:
        inodes = _socket_inodes(os.getpid() if pid is None else pid)
        for protocol, protocol_number in _PROTOCOLS.items():
            for family, family_number in _FAMILIES.items():
                dumped = dump_sockets(family_number, protocol_number)
                read += [_socket(protocol, family, each) for each in dumped if each.inode in inodes]
    except OSError:  # a DiagError is one
        return None
    return tuple(
        sorted(read, key=lambda each: (each.protocol, each.family, each.local_port, each.remote_port))
    )


def _socket_inodes(pid: int) -> set[int]:
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            if found := re.fullmatch(r"socket:\[(\d+)\]", str(descriptor.readlink())):
                inodes.add(int(found[1]))
    return inodes


def _socket(protocol: str, family: str, dumped: DiagSocket) -> Socket:
    memory = dumped.attributes.get(MEMORY, b"")
    numbers = struct.unpack_from(f"={len(memory) // 4}I", memory)
    if len(numbers) <= _SEND_BUFFER:
        raise DiagError(errno.ENODATA, "the kernel tells no buffer sizes")
    is_listening = protocol == "tcp" and dumped.state == _LISTEN
    return Socket(
        protocol=protocol,
        family=family,
        local_address=dumped.local[0],
        local_port=dumped.local[1],
        remote_address=dumped.remote[0],
        remote_port=dumped.remote[1],
        receive_buffer_bytes=numbers[_RECEIVE_BUFFER],
        send_buffer_bytes=numbers[_SEND_BUFFER],
        dropped=numbers[_DROPS] if len(numbers) > _DROPS else 0,  # since Linux 4.6
        inode=dumped.inode,
        is_listening=is_listening,
        tcp=_tcp_state(dumped) if protocol == "tcp" and not is_listening else None,
    )


def _tcp_state(dumped: DiagSocket) -> TcpState:
    info = dumped.attributes.get(INFO, b"")
    congestion_control = dumped.attributes.get(CONGESTION, b"").rstrip(b"\0").decode("ascii", "replace")
    return TcpState(
        congestion_control,
        rtt_us=_number("=I", info, _TCP_RTT_US),
        congestion_window=_number("=I", info, _TCP_CWND),
        retransmitted=_number("=I", info, _TCP_RETRANSMITTED),
        acked_bytes=_number("=Q", info, _TCP_ACKED),
        received_bytes=_number("=Q", info, _TCP_RECEIVED),
    )


def _number(layout: str, data: bytes, offset: int) -> int:
    """Return the number at `offset`, 0 where an older kernel ends before it."""
    is_there = offset + struct.calcsize(layout) <= len(data)
    return int(struct.unpack_from(layout, data, offset)[0]) if is_there else 0
