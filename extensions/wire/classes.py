"""Classes of traffic by purpose: of RTPS submessages, and of TCP segments."""

from __future__ import annotations

from collections.abc import Hashable
from enum import Enum

from . import rtps


class WireClass(str, Enum):
    """Purposes of bytes on the wire (docs/reference/wire.md); a packet with several counts for the first of them."""

    DATA_FRAG = "data_frag"
    DATA_FRAG_AGAIN = "data_frag_again"
    DATA = "data"
    DATA_AGAIN = "data_again"
    GAP = "gap"
    HEARTBEAT = "heartbeat"
    HEARTBEAT_FRAG = "heartbeat_frag"
    NACK_FRAG = "nack_frag"
    ACKNACK = "acknack"
    SPDP = "spdp"
    SEDP = "sedp"
    LIVELINESS = "liveliness"
    SECURE = "secure"
    RTPS_OTHER = "rtps_other"
    TCP_DATA = "tcp_data"
    TCP_DATA_AGAIN = "tcp_data_again"
    TCP_CONTROL = "tcp_control"
    UDP_OTHER = "udp_other"
    FRAGMENT_UNKNOWN = "fragment_unknown"


RANK = {kind: number for number, kind in enumerate(WireClass)}
AGAIN = {WireClass.DATA: WireClass.DATA_AGAIN, WireClass.DATA_FRAG: WireClass.DATA_FRAG_AGAIN}

_BUILTIN_KIND = 0xC0
"""Bits of an entity id's last octet that mark discovery (DDSI-RTPS 2.5, table 9.1)."""
_BUILTIN_WRITERS = {
    0x000100C2: WireClass.SPDP,
    0xFF0101C2: WireClass.SPDP,  # DDS Security's
    0x000200C2: WireClass.LIVELINESS,
    0xFF0200C2: WireClass.LIVELINESS,
}
"""Well-known writers (9.3.1.5 and DDS Security 7.4.7); all other built-in ones announce or ask about endpoints."""

_KINDS = {
    rtps.DATA: WireClass.DATA,
    rtps.DATA_FRAG: WireClass.DATA_FRAG,
    rtps.GAP: WireClass.GAP,
    rtps.HEARTBEAT: WireClass.HEARTBEAT,
    rtps.HEARTBEAT_FRAG: WireClass.HEARTBEAT_FRAG,
    rtps.ACKNACK: WireClass.ACKNACK,
    rtps.NACK_FRAG: WireClass.NACK_FRAG,
    **dict.fromkeys(rtps.SECURE_KINDS, WireClass.SECURE),
}


def class_of(kind: int, writer: int) -> WireClass | None:
    """Return the class of a submessage's first sending, of discovery by its writer; None if it carries nothing."""
    if kind in rtps.CONTEXT_KINDS:
        return None
    if writer & _BUILTIN_KIND == _BUILTIN_KIND:
        return _BUILTIN_WRITERS.get(writer, WireClass.SEDP)
    return _KINDS.get(kind, WireClass.RTPS_OTHER)


_SYN, _RST = 0x02, 0x04
_HALF = 1 << 31
_MODULUS = 1 << 32


class TcpFlows:
    def __init__(self) -> None:
        self._next: dict[Hashable, int] = {}

    def note(self, flow: Hashable, sequence: int, payload_bytes: int, flags: int) -> tuple[WireClass, int]:
        if flags & (_SYN | _RST):
            self._next.pop(flow, None)  # its ports are used again
            return WireClass.TCP_CONTROL, 0
        if payload_bytes == 0:
            return WireClass.TCP_CONTROL, 0
        following = (sequence + payload_bytes) % _MODULUS
        highest = self._next.setdefault(flow, sequence)
        ahead = (following - highest + _HALF) % _MODULUS - _HALF
        if ahead > 0:
            self._next[flow] = following
        again = payload_bytes - max(0, min(ahead, payload_bytes))
        return WireClass.TCP_DATA_AGAIN if again else WireClass.TCP_DATA, again
