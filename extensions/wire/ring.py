"""Frames of one interface from a ring that the kernel fills (AF_PACKET, TPACKET_V3, packet_mmap.rst)."""

from __future__ import annotations

import mmap
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from dds_trace.base.errors import OptionError
from dds_trace.recorder.kernel.counters import ask_interface

from .frames import FrameBatch, Numbers
from .packet_filter import attach_filter

NO_CAPTURE = (
    "--wire needs the capability CAP_NET_RAW: run as root, give it to the interpreter "
    "(setcap cap_net_raw+ep PYTHON), or leave --wire out"
)

# <linux/if_packet.h>, <linux/if_ether.h>, <linux/if_arp.h>
_SOL_PACKET, _ETH_P_ALL = 263, 3
_PACKET_RX_RING, _PACKET_STATISTICS, _PACKET_VERSION, _PACKET_IGNORE_OUTGOING = 5, 6, 10, 23
_TPACKET_V3, _TP_STATUS_USER = 2, 1
_SIOCGIFHWADDR = 0x8927
_ARPHRD_ETHER, _ARPHRD_LOOPBACK = 1, 772
_BLOCK_BYTES = 1 << 18
_FRAME_BYTES = 2048
"""Required, but version 3 packs frames of any size."""

# Words of struct tpacket_block_desc and struct tpacket3_hdr.
_BLOCK_STATUS, _BLOCK_PACKETS, _BLOCK_FIRST = 2, 3, 4
_NEXT, _SECONDS, _NANOSECONDS, _CAPTURED, _WIRE, _MAC_AND_NET = 0, 1, 2, 3, 4, 6
_PACKET_TYPE_BYTE = 48 + 10
"""`sll_pkttype` of the sockaddr_ll that follows each header of 48 bytes."""


def may_capture() -> bool:
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0).close()
    except OSError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class RingStatistics:
    """Since the previous call: packets that passed the filter, that found no room, and how often the ring was full."""

    packets: int
    drops: int
    freezes: int


class PacketRing:
    """A socket with its ring on one interface; the kernel delivers a full block, or any after `block_timeout_ms`.

    On `lo`, which frames pass twice, only the incoming pass is captured. An `OptionError` names what cannot be captured.
    """

    def __init__(self, interface: str, program: bytes, *, ring_bytes: int, block_timeout_ms: int) -> None:
        self.interface = interface
        self.is_loopback = _hardware_type(interface) == _ARPHRD_LOOPBACK
        self._block_bytes = _BLOCK_BYTES
        self._blocks = max(2, ring_bytes // _BLOCK_BYTES)
        self._next = 0
        self._unreleased = 0
        try:
            # Protocol 0: nothing arrives before the filter is in place.
            self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        except PermissionError as err:
            raise OptionError(NO_CAPTURE) from err
        try:
            self._set_up(program, block_timeout_ms)
        except OSError as err:
            self._socket.close()
            raise OptionError(f"--wire: cannot capture on {interface}: {err.strerror}") from err

    def _set_up(self, program: bytes, block_timeout_ms: int) -> None:
        size = self._blocks * self._block_bytes
        self._socket.setsockopt(_SOL_PACKET, _PACKET_VERSION, _TPACKET_V3)
        geometry = (self._block_bytes, self._blocks, _FRAME_BYTES, size // _FRAME_BYTES, block_timeout_ms, 0, 0)
        self._socket.setsockopt(_SOL_PACKET, _PACKET_RX_RING, struct.pack("7I", *geometry))
        attach_filter(self._socket, program)
        if self.is_loopback:
            self._socket.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
        self._map = mmap.mmap(self._socket.fileno(), size)
        self._memory = np.frombuffer(self._map, np.uint8)
        self._words = memoryview(self._map).cast("I")
        self._socket.bind((self.interface, _ETH_P_ALL))

    def read(self) -> FrameBatch:
        words, block_words = self._words, self._block_bytes // 4
        headers: list[int] = []
        while self._unreleased < self._blocks:
            start = (self._next + self._unreleased) % self._blocks * block_words
            if not words[start + _BLOCK_STATUS] & _TP_STATUS_USER:
                break
            at = start + words[start + _BLOCK_FIRST] // 4
            for _ in range(words[start + _BLOCK_PACKETS]):
                headers.append(at)
                at += words[at + _NEXT] // 4
            self._unreleased += 1
        return self._batch(np.array(headers, np.int64))

    def _batch(self, header: Numbers) -> FrameBatch:
        words = self._memory.view(np.uint32)
        mac_bytes = (words[header + _MAC_AND_NET] & 0xFFFF).astype(np.int64)
        return FrameBatch(
            self._memory,
            header * 4 + mac_bytes,
            words[header + _CAPTURED].astype(np.int64),
            words[header + _WIRE].astype(np.int64),
            words[header + _SECONDS].astype(np.int64) * 1_000_000_000 + words[header + _NANOSECONDS],
            self._memory[header * 4 + _PACKET_TYPE_BYTE],
        )

    def release(self) -> None:
        for _ in range(self._unreleased):
            self._words[self._next * (self._block_bytes // 4) + _BLOCK_STATUS] = 0
            self._next = (self._next + 1) % self._blocks
        self._unreleased = 0

    def statistics(self) -> RingStatistics:
        return RingStatistics(*struct.unpack("3I", self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 12)))

    def close(self) -> None:
        self._socket.close()
        self._words.release()
        del self._memory
        with suppress(BufferError):  # a batch still refers to the map
            self._map.close()


def _hardware_type(interface: str) -> int:
    try:
        number = ask_interface(interface, _SIOCGIFHWADDR)
    except OSError as err:
        raise OptionError(f"--wire: there is no network interface {interface!r}") from err
    if number not in (_ARPHRD_ETHER, _ARPHRD_LOOPBACK):
        raise OptionError(f"--wire: {interface} has no Ethernet frames (type {number})")
    return number


def permitted() -> Iterator[tuple[str, str, bool, str]]:
    """Yield the check of `doctor` whether this process may capture packets."""
    yield "permissions", "--wire", may_capture(), "permitted" if may_capture() else NO_CAPTURE
