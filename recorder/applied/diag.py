"""Sockets as the kernel reports them over netlink (sock_diag(7)).

Linux answers without privileges for the caller's network namespace. The layouts are in <linux/inet_diag.h>,
<linux/sock_diag.h> and struct tcp_info of <linux/tcp.h>, to which fields are only ever appended.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

NETLINK_SOCK_DIAG = 4
RECEIVE_BYTES = 1 << 16
_SOCK_DIAG_BY_FAMILY = 20
_NLM_F_REQUEST, _NLM_F_DUMP = 0x1, 0x300
_NLMSG_ERROR, _NLMSG_DONE = 2, 3
_ALL_STATES = 0xFFFFFFFF
_TIMEOUT_S = 2.0
"""For a kernel that does not answer; an answer takes less than a millisecond."""

INFO, CONGESTION, MEMORY = 2, 4, 7
"""INET_DIAG_INFO, INET_DIAG_CONG and INET_DIAG_SKMEMINFO."""

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
_ADDRESS_BYTES = {socket.AF_INET: 4, socket.AF_INET6: 16}
_INFO_BYTES = 256


class DiagError(OSError):
    """The kernel does not answer, or lacks the module of a protocol."""


@dataclass(frozen=True, slots=True)
class DiagSocket:
    """One socket; `local` and `remote` are address and port (port 0: not connected), `attributes` bytes by their number.

    Attributes:
        state: number of its TCP state (1 established, 7 closed or not connected, 10 listening).
    """

    local: tuple[str, int]
    remote: tuple[str, int]
    state: int
    inode: int
    cookie: int
    attributes: Mapping[int, bytes]


def dump_sockets(family: int, protocol: int, states: int = _ALL_STATES) -> list[DiagSocket]:
    """Return the sockets of a family and protocol in this network namespace; `states` has a bit for each state.

    Raises:
        DiagError: the kernel refuses, or does not know the protocol here.
    """
    attributes = sum(1 << (attribute - 1) for attribute in (INFO, CONGESTION, MEMORY))
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


def tcp_info_fields(info: bytes, layout: Mapping[str, tuple[str, int]]) -> dict[str, Any]:
    """Return fields of a struct tcp_info, by format and offset; 0 for those that an older kernel lacks."""
    padded = info.ljust(_INFO_BYTES, b"\0")
    return {name: struct.unpack_from(form, padded, offset)[0] for name, (form, offset) in layout.items()}


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
