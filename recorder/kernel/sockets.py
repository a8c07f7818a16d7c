"""UDP and TCP sockets as the kernel reports them over netlink (sock_diag(7)).

Linux answers without privileges for the caller's network namespace. The layouts are in <linux/inet_diag.h>,
<linux/sock_diag.h> and struct tcp_info of <linux/tcp.h>, to which fields are only ever appended.
"""

from __future__ import annotations

import errno
import os
import re
import socket
import struct
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any

NETLINK_SOCK_DIAG = 4
RECEIVE_BYTES = 1 << 16
_SOCK_DIAG_BY_FAMILY = 20
_NLM_F_REQUEST, _NLM_F_DUMP = 0x1, 0x300
_NLMSG_ERROR, _NLMSG_DONE = 2, 3
_LISTEN = 10
_ALL_STATES = 0xFFFFFFFF
_TIMEOUT_S = 2.0
"""For a kernel that does not answer; an answer takes less than a millisecond."""

ASK_S, _BETWEEN_S = 3.5, 0.1
"""The kernel knows after 3 s that no device has an address, and a host refuses datagrams once a second."""
_IP_RECVERR = 11  # linux/in.h

INFO, _CONGESTION, _MEMORY = 2, 4, 7
"""INET_DIAG_INFO, INET_DIAG_CONG and INET_DIAG_SKMEMINFO."""
_RECEIVE_BUFFER, _SEND_BUFFER, _DROPS = 1, 3, 8
"""Of enum sk_meminfo_vars in <linux/sock_diag.h>, 32-bit numbers."""

_HEADER = struct.Struct("=IHHII")  # struct nlmsghdr: length, type, flags, sequence, port
_REQUEST = struct.Struct("=BBBxI48x")  # struct inet_diag_req_v2 with an empty socket id
_ADDRESSES = struct.Struct("!HH16s16s")  # of struct inet_diag_sockid, in network byte order
_ADDRESSES_OFFSET = 4
_COOKIE = slice(44, 52)
_INODE = struct.Struct("=I")
_INODE_OFFSET = 68
_MESSAGE_BYTES = 72  # struct inet_diag_msg
_ERROR_BYTES = 4  # of the number at the start of the body
_ATTRIBUTE = struct.Struct("=HH")  # struct nlattr: length, type
FAMILIES = {"ipv4": socket.AF_INET, "ipv6": socket.AF_INET6}
_ADDRESS_BYTES = {socket.AF_INET: 4, socket.AF_INET6: 16}
_PROTOCOLS = {"udp": socket.IPPROTO_UDP, "tcp": socket.IPPROTO_TCP}

_INFO_BYTES = 256
_INFO_FIELDS = {
    # field -> (format, offset in struct tcp_info)
    "segment_bytes": ("=I", 16),
    "rtt_us": ("=I", 68),
    "rtt_variance_us": ("=I", 72),
    "congestion_window": ("=I", 80),
    "retransmitted": ("=I", 100),
    "retransmitted_segments": ("=I", 100),
    "acked_bytes": ("=Q", 120),
    "received_bytes": ("=Q", 128),
    "segments_out": ("=I", 136),
    "segments_in": ("=I", 140),
    "rtt_min_us": ("=I", 148),
    "bytes_sent": ("=Q", 200),
    "bytes_retransmitted": ("=Q", 208),
}
_NOT_MEASURED = 0xFFFFFFFF


class DiagError(OSError):
    """The kernel does not answer, or lacks the module of a protocol."""


@dataclass(frozen=True, slots=True)
class DiagSocket:
    """One socket: address and port of both ends (port 0: not connected), number of its TCP state (10: listening)."""

    local: tuple[str, int]
    remote: tuple[str, int]
    state: int
    inode: int
    cookie: int
    attributes: Mapping[int, bytes]


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
    """One UDP or TCP socket of a process (docs/trace-format.md); `0.0.0.0` and 0 as remote end if it is not connected."""

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
        return ip_address(self.remote_address).is_loopback


def tcp_info_fields(info: bytes, record: type[Any]) -> dict[str, Any]:
    """Return the fields of a record that are in a struct tcp_info; 0 for those that an older kernel lacks."""
    padded = info.ljust(_INFO_BYTES, b"\0")
    layout = {name: _INFO_FIELDS[name] for name in record.__dataclass_fields__ if name in _INFO_FIELDS}
    values = {name: struct.unpack_from(form, padded, offset)[0] for name, (form, offset) in layout.items()}
    return {name: 0 if name == "rtt_min_us" and value == _NOT_MEASURED else value for name, value in values.items()}


def read_sockets(pid: int | None = None) -> tuple[Socket, ...] | None:
    """Return a process's sockets, sorted; None if the kernel does not answer or the process may not be inspected."""
    sockets = []
    try:
        names = (str(target) for _, target in open_files(os.getpid() if pid is None else pid))
        inodes = {int(match[1]) for name in names if (match := re.fullmatch(r"socket:\[(\d+)\]", name))}
        for protocol, protocol_number in _PROTOCOLS.items():
            for family, family_number in FAMILIES.items():
                dumped = dump_sockets(family_number, protocol_number)
                sockets += [_socket(protocol, family, entry) for entry in dumped if entry.inode in inodes]
    except OSError:  # a DiagError is one
        return None
    return tuple(sorted(sockets, key=lambda read: (read.protocol, read.family, read.local_port, read.remote_port)))


def open_files(pid: int) -> Iterator[tuple[int, Path]]:
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            yield int(descriptor.name), descriptor.readlink()


def _socket(protocol: str, family: str, dumped: DiagSocket) -> Socket:
    memory = dumped.attributes.get(_MEMORY, b"")
    numbers = struct.unpack_from(f"={len(memory) // 4}I", memory)
    if len(numbers) <= _SEND_BUFFER:
        raise DiagError(errno.ENODATA, "the kernel reports no buffer sizes")
    is_listening = protocol == "tcp" and dumped.state == _LISTEN
    tcp = None
    if protocol == "tcp" and not is_listening:
        congestion_control = dumped.attributes.get(_CONGESTION, b"").rstrip(b"\0").decode("ascii", "replace")
        tcp = TcpState(congestion_control, **tcp_info_fields(dumped.attributes.get(INFO, b""), TcpState))
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
        tcp=tcp,
    )


def dump_sockets(family: int, protocol: int, states: int = _ALL_STATES) -> list[DiagSocket]:
    """Return the sockets of a family and protocol in this network namespace; `states` has a bit for each state. A `DiagError` if the kernel refuses."""
    attributes = sum(1 << (attribute - 1) for attribute in (INFO, _CONGESTION, _MEMORY))
    request = _REQUEST.pack(family, protocol, attributes, states)
    header = _HEADER.pack(_HEADER.size + len(request), _SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST | _NLM_F_DUMP, 1, 0)
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, NETLINK_SOCK_DIAG) as link:
            link.settimeout(_TIMEOUT_S)
            link.sendto(header + request, (0, 0))
            return [parse_socket(body) for body in _bodies(link)]
    except DiagError:
        raise
    except OSError as err:
        raise DiagError(err.errno, f"no answer over sock_diag: {err}") from err


def _bodies(link: socket.socket) -> Iterator[bytes]:
    while True:
        for kind, body in netlink_messages(link.recv(RECEIVE_BYTES)):
            if kind in (_NLMSG_DONE, _NLMSG_ERROR):
                # ENOENT at the end: the protocol has no module here.
                number = struct.unpack_from("=i", body)[0] if len(body) >= _ERROR_BYTES else 0
                if number < 0:
                    raise DiagError(-number, "the kernel refuses a dump over sock_diag")
                return
            yield body


def netlink_messages(data: bytes) -> Iterator[tuple[int, bytes]]:
    while data:
        length, kind, *_ = _HEADER.unpack_from(data)
        yield kind, data[_HEADER.size : length]
        data = data[_aligned(length) :]


def parse_socket(body: bytes) -> DiagSocket:
    family, state = socket.AddressFamily(body[0]), body[1]
    local_port, remote_port, local, remote = _ADDRESSES.unpack_from(body, _ADDRESSES_OFFSET)
    size = _ADDRESS_BYTES[family]
    return DiagSocket(
        local=(socket.inet_ntop(family, local[:size]), local_port),
        remote=(socket.inet_ntop(family, remote[:size]), remote_port),
        state=state,
        inode=_INODE.unpack_from(body, _INODE_OFFSET)[0],
        cookie=int.from_bytes(body[_COOKIE], "little"),
        attributes=dict(_attributes(body)),
    )


def _attributes(body: bytes) -> Iterator[tuple[int, bytes]]:
    offset = _MESSAGE_BYTES
    while offset + _ATTRIBUTE.size <= len(body):
        length, kind = _ATTRIBUTE.unpack_from(body, offset)
        if length < _ATTRIBUTE.size:
            return
        yield kind, body[offset + _ATTRIBUTE.size : offset + length]
        offset += _aligned(length)


def _aligned(length: int) -> int:
    return (length + 3) & ~3


def closed_ports(addresses: Iterable[tuple[str, int]]) -> list[str]:
    """Return which hosts and UDP ports nothing is at, with the reason that the network gives for an empty datagram."""
    answers, faults = [_answers(*address) for address in addresses], list[str]()
    for _ in range(round(ASK_S / _BETWEEN_S)):
        faults += filter(None, (next(answer, "") for answer in answers))
        if len(faults) == len(answers):
            break
        time.sleep(_BETWEEN_S)
    return faults


def _answers(host: str, port: int) -> Iterator[str]:
    try:
        family, _, _, _, there = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.setsockopt(socket.IPPROTO_IP, _IP_RECVERR, 1)  # else no device at all is no error
            probe.connect(there)
            while True:
                probe.send(b"")
                yield ""
    except OSError as err:
        yield f"UDP port {port} of {host} cannot be reached ({err.strerror})"
