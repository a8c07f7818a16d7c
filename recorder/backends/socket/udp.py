"""Frames in UDP datagrams, cut into fragments, without retransmission.

Anybody can write a source address. An unknown address that greets gets a cookie, in a datagram no larger than the
greeting; only a greeting with that cookie makes it a peer, to which messages go.
"""

from __future__ import annotations

import hmac
import secrets
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from ..node import ROUND_S, RawMessage
from ..other_side import Strangers
from .greeting import (
    CROWD,
    MALFORMED,
    MAX_MESSAGE_BYTES,
    MAX_PEERS,
    MEMORY_BYTES,
    RETRY_S,
    TOO_LARGE,
    Address,
    Greeting,
    Receivers,
    bound_socket,
    timeval,
)

FRAGMENT_BYTES = 60_000
"""A UDP datagram has at most 65,507 bytes; Fast DDS cuts at about the same size."""
MAX_UNFINISHED = 8
DATAGRAMS_A_ROUND = 256
GREETING_S = 1.0
FORGET_S = 10.0

_HEADER = struct.Struct("<IHHH")  # message, fragment, fragments, bytes of the name; then name and fragment
_COOKIE_MARK = b"cookie "
_COOKIE_DIGITS = 16
UNKNOWN = "datagram of an address that did not return its cookie"


@dataclass
class _UdpPeer:
    greeting: Greeting = field(default_factory=Greeting)
    heard_s: float = 0.0
    unfinished: dict[int, dict[int, bytes]] = field(default_factory=dict)


class UdpLinks:
    """As `TcpLinks`; a message with a lost fragment is lost."""

    def __init__(
        self,
        greeting: Greeting,
        listen: Address | None,
        peers: Sequence[Address],
        receivers: Receivers,
        strangers: Strangers,
        buffer_bytes: int | None = None,
        fragment_bytes: int | None = None,
    ) -> None:
        self._fragment_bytes = fragment_bytes or FRAGMENT_BYTES
        self._most_fragments = -(-MAX_MESSAGE_BYTES // self._fragment_bytes)
        self._strangers = strangers
        self._is_listening = listen is not None
        self._secret = secrets.token_bytes(16)
        self._cookies: dict[Address, str] = {}  # of relays, for our greetings to them
        self._unfinished_bytes = 0  # of all peers
        self._greeting = greeting
        self._receivers = receivers
        self._socket = bound_socket(socket.SOCK_DGRAM, listen or ("", 0))
        if buffer_bytes is not None:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
        # Not `settimeout`, with which Python calls the kernel twice for each datagram.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval(ROUND_S))
        self._buffer = memoryview(bytearray(1 << 16))
        self._number = 0
        self._numbering = threading.Lock()
        self._relays = tuple(peers)
        self._peers: dict[Address, _UdpPeer] = {}
        self._next_greeting_s = 0.0

    @property
    def receive_buffer_bytes(self) -> int:
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    @property
    def port(self) -> int:
        return int(self._socket.getsockname()[1])

    def greetings(self) -> list[Greeting]:
        return [peer.greeting for peer in list(self._peers.values())]

    def announce(self) -> None:
        for address in {*self._relays, *self._peers}:
            self._greet(address)

    def _greet(self, address: Address) -> None:
        self._send_to([address], b"", self._greeting.to_bytes(self._cookies.get(address, "")))

    def sender(self, topic: str) -> Callable[[RawMessage], None]:
        return partial(self._send, topic)

    def _send(self, topic: str, message: RawMessage) -> None:
        subscribers = [address for address, peer in list(self._peers.items()) if topic in peer.greeting.subscriptions]
        self._send_to(subscribers, topic.encode(), message)

    def _send_to(self, addresses: Sequence[Address], name: bytes, message: RawMessage) -> None:
        with self._numbering:
            self._number = number = (self._number + 1) % (1 << 32)
        most_bytes = self._fragment_bytes
        count = max(-(-len(message) // most_bytes), 1)
        with memoryview(message) as view:
            for index in range(count):
                header = _HEADER.pack(number, index, count, len(name)) + name
                part = view[index * most_bytes : (index + 1) * most_bytes]
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
                    self._forget(peer, len(peer.unfinished))
                    del self._peers[address]
            self.announce()
        with suppress(BlockingIOError):  # nothing came within `ROUND_S`
            for _ in range(DATAGRAMS_A_ROUND):
                size, address = self._socket.recvfrom_into(self._buffer)
                self._take(self._buffer[:size], address)
                if time.monotonic() >= self._next_greeting_s:
                    break

    def _take(self, datagram: memoryview, address: Address) -> None:
        try:
            name, message = self._parse(datagram, address)
        except (ValueError, MemoryError) as error:
            self._strangers.count(TOO_LARGE if isinstance(error, MemoryError) else str(error))
            return
        for receive in self._receivers.get(name, ()) if name else ():
            receive(message)

    def _parse(self, datagram: memoryview, address: Address) -> tuple[str, bytearray]:
        if len(datagram) < _HEADER.size:
            raise ValueError(MALFORMED)
        number, index, count, name_bytes = _HEADER.unpack_from(datagram)
        start = _HEADER.size + name_bytes
        part = datagram[start:]
        if len(datagram) < start or index >= count or count > self._most_fragments or len(part) > FRAGMENT_BYTES:
            raise ValueError(MALFORMED)
        peer = self._peers.get(address)
        if not name_bytes:
            self._take_greeting(bytes(part), address)
            return "", bytearray()
        if peer is None:
            raise ValueError(UNKNOWN)
        name = bytes(datagram[_HEADER.size : start]).decode(errors="replace")
        if count == 1:
            return name, bytearray(part)
        parts = peer.unfinished.setdefault(number, {})
        if index not in parts:
            parts[index] = bytes(part)
            self._unfinished_bytes += len(part)
        if len(parts) == count and max(parts) < count:
            message = bytearray().join(parts[index] for index in range(count))
            self._unfinished_bytes -= len(message)
            del peer.unfinished[number]
            return name, message
        if len(peer.unfinished) > MAX_UNFINISHED:
            self._forget(peer, 1)
        if self._unfinished_bytes > MEMORY_BYTES:
            self._forget(peer, len(peer.unfinished))
            raise ValueError(TOO_LARGE)
        return "", bytearray()

    def _forget(self, peer: _UdpPeer, messages: int) -> None:
        for number in list(peer.unfinished)[:messages]:
            self._unfinished_bytes -= sum(map(len, peer.unfinished.pop(number).values()))

    def _take_greeting(self, data: bytes, address: Address) -> None:
        is_relay = address in self._relays
        if is_relay and data.startswith(_COOKIE_MARK) and len(data) <= len(_COOKIE_MARK) + _COOKIE_DIGITS:
            self._cookies[address] = data[len(_COOKIE_MARK) :].decode("ascii", "replace")
            self._greet(address)
            return
        greeting = Greeting.from_bytes(data)
        if greeting is None:
            raise ValueError(MALFORMED)
        if not is_relay:
            cookie = hmac.new(self._secret, repr(address).encode(), "sha256").hexdigest()[:_COOKIE_DIGITS]
            if not self._is_listening:
                raise ValueError(UNKNOWN)
            if not hmac.compare_digest(greeting.cookie, cookie):
                if len(data) > len(_COOKIE_MARK) + len(cookie):  # never more than was sent from there
                    self._send_to([address], b"", _COOKIE_MARK + cookie.encode())
                return
        peer = self._peers.get(address)
        if peer is None:
            if len(self._peers) >= MAX_PEERS:
                raise ValueError(CROWD)
            peer = self._peers[address] = _UdpPeer()
            self._greet(address)
        peer.greeting, peer.heard_s = greeting, time.monotonic()

    def interrupt(self) -> None:
        """Do nothing: sending never blocks."""

    def close(self) -> None:
        self._socket.close()
