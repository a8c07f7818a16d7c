"""TCP connections of any process in this network namespace, by `TCP_INFO`."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from dds_trace.base.errors import OptionError

from ..applied.diag import (
    INFO,
    NETLINK_SOCK_DIAG,
    RECEIVE_BYTES,
    DiagError,
    DiagSocket,
    dump_sockets,
    netlink_messages,
    parse_socket,
    tcp_info_fields,
)
from .packets.packet_filter import PortRange

_TCP_DESTROYED_GROUP = 1 << 0  # SKNLGRP_INET_TCP_DESTROY as a bit of the address
_CONNECTED_STATES = 0xFFF & ~(1 << 10) & ~(1 << 6)  # not LISTEN, not TIME_WAIT
_NOT_MEASURED = 0xFFFFFFFF

_INFO_FIELDS = {
    # field -> (format, offset in struct tcp_info)
    "segment_bytes": ("=I", 16),
    "rtt_us": ("=I", 68),
    "rtt_variance_us": ("=I", 72),
    "congestion_window": ("=I", 80),
    "retransmitted_segments": ("=I", 100),
    "segments_out": ("=I", 136),
    "segments_in": ("=I", 140),
    "rtt_min_us": ("=I", 148),
    "bytes_sent": ("=Q", 200),
    "bytes_retransmitted": ("=Q", 208),
}
_COUNTERS = ("retransmitted_segments", "segments_out", "segments_in", "bytes_sent", "bytes_retransmitted")


@dataclass(frozen=True, slots=True)
class TcpConnection:
    """One end of a connection, without addresses, which may identify a device; counters since it opened, or of a run.

    Attributes:
        rtt_us, rtt_variance_us, rtt_min_us: smoothed round-trip time of the kernel, now.
    """

    local_port: int
    remote_port: int
    retransmitted_segments: int = 0
    bytes_retransmitted: int = 0
    bytes_sent: int = 0
    segments_out: int = 0
    segments_in: int = 0
    segment_bytes: int = 0
    rtt_us: int = 0
    rtt_variance_us: int = 0
    rtt_min_us: int = 0
    congestion_window: int = 0

    def since(self, before: TcpConnection | None) -> TcpConnection:
        """Return the connection with its counters since `before`."""
        if before is None:
            return self
        return replace(self, **{name: getattr(self, name) - getattr(before, name) for name in _COUNTERS})


def parse_tcp_info(info: bytes, local_port: int, remote_port: int) -> TcpConnection:
    values = tcp_info_fields(info, _INFO_FIELDS)
    if values["rtt_min_us"] == _NOT_MEASURED:
        values["rtt_min_us"] = 0
    return TcpConnection(local_port, remote_port, **values)


def read_connections(ports: Sequence[PortRange]) -> dict[int, TcpConnection]:
    """Return, by the kernel's socket cookie, this network namespace's connections with a port in a range."""
    sockets: list[DiagSocket] = []
    for family in (socket.AF_INET, socket.AF_INET6):
        with suppress(DiagError):  # a kernel without this family
            sockets += dump_sockets(family, socket.IPPROTO_TCP, _CONNECTED_STATES)
    return _with_ports(sockets, ports)


class ClosedConnections:
    """Listener for connections that end in this network namespace, with their last `TCP_INFO`.

    A connection that is read once a second has sent more when it ends.

    Raises:
        OptionError: the kernel was built without sock_diag.
    """

    def __init__(self, ports: Sequence[PortRange]) -> None:
        self._ports = ports
        try:
            self._link = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, NETLINK_SOCK_DIAG)
        except OSError as err:
            raise OptionError(f"--wire: this kernel does not report TCP connections: {err.strerror}") from err
        self._link.setblocking(False)
        self._link.bind((0, _TCP_DESTROYED_GROUP))

    def fileno(self) -> int:
        return self._link.fileno()

    def read(self) -> dict[int, TcpConnection]:
        """Return the connections that ended since the last call, by cookie."""
        ended: dict[int, TcpConnection] = {}
        # BlockingIOError: no more. ENOBUFS: so many ended at once that some are missing; their last reading counts.
        with suppress(OSError):
            while True:
                messages = netlink_messages(self._link.recv(RECEIVE_BYTES))
                ended |= _with_ports([parse_socket(body) for _, body in messages], self._ports)
        return ended

    def close(self) -> None:
        self._link.close()


def _with_ports(sockets: Iterable[DiagSocket], ports: Sequence[PortRange]) -> dict[int, TcpConnection]:
    return {
        opened.cookie: parse_tcp_info(opened.attributes.get(INFO, b""), opened.local[1], opened.remote[1])
        for opened in sockets
        if opened.remote[1]  # a listening socket has none
        and any(first <= end[1] <= last for first, last in ports for end in (opened.local, opened.remote))
    }
