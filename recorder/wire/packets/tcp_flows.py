"""TCP segments as they pass: which bytes a flow sends for the first time, and which again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .classes import WireClass

if TYPE_CHECKING:
    from collections.abc import Hashable

_SYN, _RST = 0x02, 0x04
_HALF = 1 << 31
_MODULUS = 1 << 32


class TcpFlows:
    """Flows, one a direction, by the highest sequence number that was seen."""

    def __init__(self) -> None:
        self._next: dict[Hashable, int] = {}

    def note(self, flow: Hashable, sequence: int, payload_bytes: int, flags: int) -> tuple[WireClass, int]:
        """Note a segment; return its class, and how many bytes of its payload had been on the wire before.

        Args:
            flow: addresses and ports, in the direction of the segment.
            sequence: number of its first payload byte, modulo 2**32.
            payload_bytes: of TCP; 0 for an acknowledgement.
            flags: of the TCP header.
        """
        if flags & (_SYN | _RST):
            self._next.pop(flow, None)  # the ports of an earlier connection, used again
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
