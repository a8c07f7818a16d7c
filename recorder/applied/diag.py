"""Sockets as the kernel knows them: a dump of one family and protocol over netlink (sock_diag(7)).

Linux answers without any privilege for the sockets of the caller's network namespace. The layouts are those of
<linux/inet_diag.h> and <linux/sock_diag.h>, which are part of the kernel's stable interface.
"""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_NETLINK_SOCK_DIAG = 4
_SOCK_DIAG_BY_FAMILY = 20
_NLM_F_REQUEST, _NLM_F_DUMP = 0x1, 0x300
_NLMSG_ERROR, _NLMSG_DONE = 2, 3
_ALL_STATES = 0xFFFFFFFF
_RECEIVE_BYTES = 1 << 16
_TIMEOUT_S = 2.0
"""Bound on a kernel that does not answer; an answer takes less than a millisecond."""

INFO, CONGESTION, MEMORY = 2, 4, 7
"""Attributes INET_DIAG_INFO, INET_DIAG_CONG and INET_DIAG_SKMEMINFO."""

_HEADER = struct.Struct("=IHHII")  # struct nlmsghdr: length, type, flags, sequence, port
_REQUEST = struct.Struct("=BBBxI48x")  # struct inet_diag_req_v2 with an empty socket id
_ADDRESSES = struct.Struct("!HH16s16s")  # of struct inet_diag_sockid, in network byte order
_ADDRESSES_OFFSET = 4
_INODE = struct.Struct("=I")
_INODE_OFFSET = 68
_MESSAGE_BYTES = 72  # struct inet_diag_msg
_STATE_OFFSET = 1
_ERROR_BYTES = 4  # of the number at the beginning of an error's and an end's body
_ATTRIBUTE = struct.Struct("=HH")  # struct nlattr: length, type
_ADDRESS_BYTES = {socket.AF_INET: 4, socket.AF_INET6: 16}


class DiagError(OSError):
    """The kernel does not answer, or lacks the module of a protocol."""


@dataclass(frozen=True, slots=True)
class DiagSocket:
    """One socket of a dump.

    Attributes:
        local: address and port that it is bound to.
        remote: address and port that it is connected to; the port is 0 if it is not.
        state: number of its TCP state (1 established, 7 closed or not connected, 10 listening).
        inode: number of its inode, as in the links of `/proc/PID/fd`.
        attributes: number of an attribute -> its bytes.
    """

    local: tuple[str, int]
    remote: tuple[str, int]
    state: int
    inode: int
    attributes: Mapping[int, bytes]


def dump_sockets(family: int, protocol: int) -> list[DiagSocket]:
    """Return all sockets of a family and protocol in this network namespace.

    Args:
        family: `AF_INET` or `AF_INET6`.
        protocol: `IPPROTO_UDP` or `IPPROTO_TCP`.

    Raises:
        DiagError: the kernel refuses, or does not know the protocol here.
    """
    asked = sum(1 << (attribute - 1) for attribute in (INFO, CONGESTION, MEMORY))
    request = _REQUEST.pack(family, protocol, asked, _ALL_STATES)
    header = _HEADER.pack(
        _HEADER.size + len(request), _SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST | _NLM_F_DUMP, 1, 0
    )
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG) as link:
            link.settimeout(_TIMEOUT_S)
            link.sendto(header + request, (0, 0))
            return [_parsed(family, body) for body in _bodies(link)]
    except DiagError:
        raise
    except OSError as err:
        raise DiagError(err.errno, f"no answer over sock_diag: {err}") from err


def _bodies(link: socket.socket) -> Iterator[bytes]:
    """Yield the body of each message of one dump."""
    while True:
        data, offset = link.recv(_RECEIVE_BYTES), 0
        while offset < len(data):
            length, kind, *_ = _HEADER.unpack_from(data, offset)
            body = data[offset + _HEADER.size : offset + length]
            if kind in (_NLMSG_DONE, _NLMSG_ERROR):
                # The end too carries an error: a dump whose protocol has no module here is empty and ends with ENOENT.
                number = struct.unpack_from("=i", body)[0] if len(body) >= _ERROR_BYTES else 0
                if number < 0:
                    raise DiagError(-number, "the kernel refuses a dump over sock_diag")
                return
            yield body
            offset += _aligned(length)


def _parsed(family: int, body: bytes) -> DiagSocket:
    local_port, remote_port, local, remote = _ADDRESSES.unpack_from(body, _ADDRESSES_OFFSET)
    size = _ADDRESS_BYTES[socket.AddressFamily(family)]
    return DiagSocket(
        local=(socket.inet_ntop(family, local[:size]), local_port),
        remote=(socket.inet_ntop(family, remote[:size]), remote_port),
        state=body[_STATE_OFFSET],
        inode=_INODE.unpack_from(body, _INODE_OFFSET)[0],
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
    """Return the length with the padding to 4 bytes that netlink puts behind each message and attribute."""
    return (length + 3) & ~3
