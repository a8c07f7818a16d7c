"""Frames in UDP datagrams, cut into fragments, without retransmission."""

from __future__ import annotations

import socket
import struct
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from ..node import ROUND_S
from .greeting import RETRY_S, Greeting, bound_socket

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..node import RawMessage
    from .greeting import Address, Receivers

FRAGMENT_BYTES = 60_000
"""Bytes of a message in one UDP datagram (65,507 bytes with its header); Fast DDS cuts at about the same size."""
MAX_UNFINISHED = 8
"""Most messages of one sender that wait for fragments; then the oldest is lost."""
DATAGRAMS_A_ROUND = 256
GREETING_S = 1.0
FORGET_S = 10.0
"""Silence after which a peer is forgotten."""

_TIME = struct.Struct("@ll")  # struct timeval: seconds, microseconds
_HEADER = struct.Struct("<IHHH")  # message, fragment, fragments, bytes of the name; then name and fragment


@dataclass
class _UdpPeer:
    """A peer that has greeted: the time of its last greeting, and its messages that lack fragments."""

    greeting: Greeting = field(default_factory=Greeting)
    heard_s: float = 0.0
    unfinished: dict[int, list[bytes | None]] = field(default_factory=dict)


class UdpLinks:
    """Datagrams to all peers that greet; a message with a lost fragment is lost. As `TcpLinks`."""

    def __init__(
        self,
        own: Greeting,
        listen: Address | None,
        peers: Sequence[Address],
        receivers: Receivers,
        buffer_bytes: int | None = None,
    ) -> None:
        self._own = own
        self._receivers = receivers
        self._socket = bound_socket(socket.SOCK_DGRAM, listen or ("", 0))
        if buffer_bytes is not None:
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                self._socket.setsockopt(socket.SOL_SOCKET, option, buffer_bytes)
        # Not `settimeout`, with which Python calls the kernel twice for each datagram.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIME.pack(0, round(ROUND_S * 1e6)))
        self._buffer = memoryview(bytearray(1 << 16))
        self._number = 0
        self._numbering = threading.Lock()
        self._relays = tuple(peers)
        self._peers: dict[Address, _UdpPeer] = {}
        self._next_greeting_s = 0.0

    @property
    def receive_buffer_bytes(self) -> int:
        """Size of the receive buffer as the kernel reports it, twice the requested one (socket(7))."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    @property
    def port(self) -> int:
        return int(self._socket.getsockname()[1])

    def greetings(self) -> list[Greeting]:
        return [peer.greeting for peer in list(self._peers.values())]

    def announce(self) -> None:
        for address in {*self._relays, *self._peers}:
            self._send_to([address], b"", self._own.to_bytes())

    def sender(self, topic: str) -> Callable[[RawMessage], None]:
        return partial(self._send, topic)

    def _send(self, topic: str, message: RawMessage) -> None:
        subscribers = [
            address for address, peer in list(self._peers.items()) if topic in peer.greeting.subscriptions
        ]
        self._send_to(subscribers, topic.encode(), message)

    def _send_to(self, addresses: Sequence[Address], name: bytes, message: RawMessage) -> None:
        with self._numbering:
            self._number = number = (self._number + 1) % (1 << 32)
        count = max(-(-len(message) // FRAGMENT_BYTES), 1)
        with memoryview(message) as view:
            for index in range(count):
                header = _HEADER.pack(number, index, count, len(name)) + name
                part = view[index * FRAGMENT_BYTES : (index + 1) * FRAGMENT_BYTES]
                for address in addresses:
                    with suppress(OSError):  # unreachable now: lost
                        self._socket.sendmsg([header, part], (), 0, address)

    def poll(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_greeting_s:
            have_met = set(self._relays) <= set(self._peers)
            self._next_greeting_s = now_s + (GREETING_S if have_met else RETRY_S)
            for address, peer in list(self._peers.items()):
                if now_s - peer.heard_s > FORGET_S:
                    del self._peers[address]
            self.announce()
        with suppress(BlockingIOError):  # nothing came within `ROUND_S`
            for _ in range(DATAGRAMS_A_ROUND):
                size, address = self._socket.recvfrom_into(self._buffer)
                self._take(self._buffer[:size], address)
                if time.monotonic() >= self._next_greeting_s:
                    break

    def _take(self, datagram: memoryview, address: Address) -> None:
        if len(datagram) < _HEADER.size:
            return
        number, index, count, name_bytes = _HEADER.unpack_from(datagram)
        start = _HEADER.size + name_bytes
        if len(datagram) < start or index >= count:
            return
        name, part = bytes(datagram[_HEADER.size : start]).decode(errors="replace"), datagram[start:]
        peer = self._peers.get(address)
        if not name:
            self._greeted(Greeting.from_bytes(bytes(part)), address)
        elif peer is None:  # a stranger
            return
        elif count == 1:
            self._deliver(name, bytearray(part))
        else:
            parts = peer.unfinished.setdefault(number, [None] * count)
            if len(parts) != count:
                return
            parts[index] = bytes(part)
            if None not in parts:
                del peer.unfinished[number]
                self._deliver(name, bytearray().join(part for part in parts if part is not None))
            elif len(peer.unfinished) > MAX_UNFINISHED:
                del peer.unfinished[next(iter(peer.unfinished))]

    def _deliver(self, topic: str, message: bytearray) -> None:
        for receive in self._receivers.get(topic, ()):
            receive(message)

    def _greeted(self, greeting: Greeting | None, address: Address) -> None:
        if greeting is None:
            return
        peer = self._peers.get(address)
        if peer is None:
            peer = self._peers[address] = _UdpPeer()
            self._send_to([address], b"", self._own.to_bytes())
        peer.greeting, peer.heard_s = greeting, time.monotonic()

    def interrupt(self) -> None:
        """Do nothing: sending a datagram never blocks."""

    def close(self) -> None:
        self._socket.close()
