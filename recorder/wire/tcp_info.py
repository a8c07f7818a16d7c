"""TCP connections by the kernel's `TCP_INFO`, of any process in this network namespace, by sock_diag.

Layouts: <linux/inet_diag.h>, <linux/sock_diag.h> and struct tcp_info of <linux/tcp.h>, of which fields are appended
and never moved; a kernel that is too old for one leaves it 0.
"""

from __future__ import annotations

import itertools
import socket
import struct
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from .packets.packet_filter import PortRange

_NETLINK_SOCK_DIAG, _SOCK_DIAG_BY_FAMILY = 4, 20
_NLM_F_REQUEST, _NLM_F_DUMP = 0x001, 0x300
_NLMSG_ERROR, _NLMSG_DONE = 2, 3
_INET_DIAG_INFO = 2
_TCP_DESTROYED_GROUP = 1 << 0  # SKNLGRP_INET_TCP_DESTROY as a bit of the address
_CONNECTED_STATES = 0xFFF & ~(1 << 10) & ~(1 << 6)  # not LISTEN, not TIME_WAIT
_NETLINK_HEADER = struct.Struct("=IHHII")
_DIAG_MESSAGE = struct.Struct("=BBBBHH16s16sI8sIIIII")
_ATTRIBUTE = struct.Struct("=HH")
_RECEIVE_BYTES = 1 << 16
_INFO_BYTES = 256
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
_COUNTERS = (
    "retransmitted_segments",
    "segments_out",
    "segments_in",
    "bytes_sent",
    "bytes_retransmitted",
)


@dataclass(frozen=True, slots=True)
class TcpConnection:
    """One end of a connection; counters since it was opened, or of a run (`since`).

    Attributes:
        local_port, remote_port: of the connection; addresses are left out, they may identify a device.
        retransmitted_segments: `tcpi_total_retrans`.
        bytes_retransmitted: `tcpi_bytes_retrans`.
        bytes_sent: payload, repetitions included (`tcpi_bytes_sent`).
        segments_out, segments_in: acknowledgements included.
        segment_bytes: the largest that it sends (`tcpi_snd_mss`).
        rtt_us, rtt_variance_us, rtt_min_us: smoothed round-trip time of the kernel, now.
        congestion_window: segments that may be under way, now.
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

    def since(self, before: TcpConnection) -> TcpConnection:
        """Return the same connection with its counters less those of `before`."""
        grown = {name: getattr(self, name) - getattr(before, name) for name in _COUNTERS}
        return TcpConnection(**{**asdict(self), **grown})

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return asdict(self)

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> TcpConnection:
        """Return the connection that a JSON object of `to_dict` holds; unknown fields are ignored, missing counters are 0."""
        known = {name: int(found[name]) for name in cls.__slots__ if name in found}
        return cls(**{"local_port": 0, "remote_port": 0, **known})


def parse_tcp_info(info: bytes, local_port: int, remote_port: int) -> TcpConnection:
    """Return the fields of a `struct tcp_info`, as sock_diag or `getsockopt(TCP_INFO)` gives it."""
    padded = info.ljust(_INFO_BYTES, b"\0")
    values = {
        name: struct.unpack_from(format_, padded, offset)[0]
        for name, (format_, offset) in _INFO_FIELDS.items()
    }
    if values["rtt_min_us"] == _NOT_MEASURED:
        values["rtt_min_us"] = 0
    return TcpConnection(local_port, remote_port, **values)


def read_socket(connection: socket.socket) -> TcpConnection:
    """Return the kernel's counters of a TCP socket of this process."""
    info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_BYTES)
    return parse_tcp_info(info, connection.getsockname()[1], connection.getpeername()[1])


def read_connections(ports: Sequence[PortRange]) -> dict[int, TcpConnection]:
    """Return the connections of this network namespace with a port in one of the ranges, by the kernel's socket cookie.

    The cookie tells a connection from a later one that has the same ports.
    """
    messages = itertools.chain(_dump(socket.AF_INET), _dump(socket.AF_INET6))
    return _with_ports(messages, ports)


class ClosedConnections:
    """Listener for connections that end in this network namespace, each with its last `TCP_INFO`.

    A connection that is read once a second has sent more when it ends.

    Args:
        ports: of the connections to hear of.

    Raises:
        OptionError: the kernel was built without sock_diag.
    """

    def __init__(self, ports: Sequence[PortRange]) -> None:
        self._ports = ports
        try:
            self._link = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG)
        except OSError as err:
            raise OptionError(
                f"--wire: this kernel does not tell of TCP connections: {err.strerror}"
            ) from err
        self._link.setblocking(False)
        self._link.bind((0, _TCP_DESTROYED_GROUP))

    def fileno(self) -> int:
        """Return the descriptor that is readable when a connection has ended."""
        return self._link.fileno()

    def read(self) -> dict[int, TcpConnection]:
        """Return the connections that ended since the last call, by cookie."""
        found: dict[int, TcpConnection] = {}
        # BlockingIOError: no more. ENOBUFS: so many ended at once that some are not told; they keep what was read before.
        with suppress(OSError):
            while True:
                contents = [content for _, content in _parts(self._link.recv(_RECEIVE_BYTES))]
                found |= _with_ports(contents, self._ports)
        return found

    def close(self) -> None:
        """Close the socket."""
        self._link.close()


def _with_ports(messages: Iterable[bytes], ports: Sequence[PortRange]) -> dict[int, TcpConnection]:
    """Return the connections in `inet_diag_msg`s that have a port in one of the ranges, by cookie."""
    return {
        cookie: connection
        for cookie, connection in map(_parse_message, messages)
        if connection.remote_port  # a listening socket has none
        and any(
            wanted.first <= port <= wanted.last
            for wanted in ports
            for port in (connection.local_port, connection.remote_port)
        )
    }


def _dump(family: int) -> Iterator[bytes]:
    """Yield the `inet_diag_msg` of each connection, with its attributes."""
    wanted = struct.pack(
        "=BBBBI48s", family, socket.IPPROTO_TCP, 1 << (_INET_DIAG_INFO - 1), 0, _CONNECTED_STATES, b""
    )
    header = _NETLINK_HEADER.pack(
        _NETLINK_HEADER.size + len(wanted), _SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST | _NLM_F_DUMP, 1, 0
    )
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG) as link:
        link.sendall(header + wanted)
        while True:
            for kind, content in _parts(link.recv(_RECEIVE_BYTES)):
                if kind in (_NLMSG_DONE, _NLMSG_ERROR):  # an error: the kernel does not have this family
                    return
                yield content


def _parts(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each netlink message."""
    while data:
        length, kind, _, _, _ = _NETLINK_HEADER.unpack_from(data)
        yield kind, data[_NETLINK_HEADER.size : length]
        data = data[_aligned(length) :]


def _parse_message(message: bytes) -> tuple[int, TcpConnection]:
    """Return the socket's cookie and the connection of one `inet_diag_msg`."""
    fields = _DIAG_MESSAGE.unpack_from(message)
    local_port, remote_port = (socket.ntohs(port) for port in fields[4:6])
    cookie = int.from_bytes(fields[9], "little")
    at, info = _DIAG_MESSAGE.size, b""
    while at + _ATTRIBUTE.size <= len(message):
        length, kind = _ATTRIBUTE.unpack_from(message, at)
        if kind == _INET_DIAG_INFO:
            info = message[at + _ATTRIBUTE.size : at + length]
        at += max(_aligned(length), _ATTRIBUTE.size)
    return cookie, parse_tcp_info(info, local_port, remote_port)


def _aligned(length: int) -> int:
    return (length + 3) & ~3
