"""How the `socket` backend moves frames: over TCP connections, or in UDP datagrams with fragments.

A frame is a topic's name and a serialized message. The empty name is a greeting: JSON that says who is there,
what it subscribes to and what it publishes; nothing is sent to a peer that does not subscribe.
"""

from __future__ import annotations

import errno
import json
import selectors
import socket
import struct
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from dds_trace.tracefile import OptionError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .base import RawMessage

TUNED_BUFFER_BYTES = 4_000_000
FRAGMENT_BYTES = 60_000
"""Of a message in one UDP datagram (65,507 bytes with its header); Fast DDS cuts at about the same size."""
MAX_UNFINISHED = 8
"""Messages of one sender that wait for fragments; an older one is lost."""
MAX_MESSAGE_BYTES = 1 << 30
"""More in a header is no frame of ours."""
DATAGRAMS_A_ROUND = 256
RETRY_S = 0.2
GREETING_S = 1.0
FORGET_S = 10.0

_TCP_HEADER = struct.Struct("<IH")  # bytes of the message, bytes of the topic's name; then name and message
_UDP_HEADER = struct.Struct(
    "<IHHH"
)  # message, fragment, fragments, bytes of the name; then name and fragment

Address = tuple[str, int]


@dataclass
class Greeting:
    """What a node says of itself: its name, and the type by topic of what it takes and gives."""

    name: str = ""
    subscriptions: dict[str, str] = field(default_factory=dict)
    publishers: dict[str, str] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        """As it travels."""
        return json.dumps(vars(self)).encode()

    @classmethod
    def from_bytes(cls, data: RawMessage) -> Greeting | None:
        """What was said, None if it is no greeting of ours."""
        try:
            found: dict[str, Any] = json.loads(data)
            return cls(str(found["name"]), dict(found["subscriptions"]), dict(found["publishers"]))
        except (ValueError, KeyError, TypeError):
            return None


class Links(Protocol):
    """The connections of one node."""

    def greetings(self) -> list[Greeting]:
        """Of the peers at the moment."""

    def announce(self) -> None:
        """Tell all peers what the own greeting says now."""

    def send(self, topic: str, message: RawMessage) -> None:
        """Send `message` to all peers that subscribe to `topic`; it is copied when this returns."""

    def poll(self, timeout_s: float) -> None:
        """Wait for so long at most, and hand on what has arrived."""

    def close(self) -> None:
        """End all connections."""


class TcpLinks:
    """Connections to peers, kept up, and from peers, on one listening socket.

    Args:
        own: the own greeting, sent to each new peer.
        listen: where to accept connections, None not to.
        peers: where to connect, again and again until it works.
        deliver: called with topic and message of each frame.
    """

    def __init__(
        self,
        own: Greeting,
        listen: Address | None,
        peers: Sequence[Address],
        deliver: Callable[[str, bytearray], None],
    ) -> None:
        self._own = own
        self._deliver = deliver
        self._selector = selectors.DefaultSelector()
        self._connected: tuple[_TcpPeer, ...] = ()
        self._wanted: dict[Address, float] = dict.fromkeys(peers, 0.0)  # -> when to try again
        self._listener = None
        if listen is not None:
            self._listener = _bound(socket.SOCK_STREAM, listen)
            self._listener.listen()
            self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def greetings(self) -> list[Greeting]:
        """Of the connected peers."""
        return [peer.greeting for peer in self._connected]

    def announce(self) -> None:
        """Send the greeting on every connection."""
        for peer in self._connected:
            peer.send(b"", self._own.to_bytes())

    def send(self, topic: str, message: RawMessage) -> None:
        """Send a frame; waits while a peer does not read."""
        for peer in self._connected:
            if topic in peer.greeting.subscriptions:
                peer.send(topic.encode(), message)

    def poll(self, timeout_s: float) -> None:
        """Serve connections for one round."""
        now_s = time.monotonic()
        for address, next_s in list(self._wanted.items()):
            if now_s >= next_s:
                self._connect(address)
        for key, _ in self._selector.select(min(timeout_s, RETRY_S)):
            key.data()

    def _accept(self) -> None:
        assert self._listener is not None
        connection, _ = self._listener.accept()
        self._add(connection, None)

    def _connect(self, address: Address) -> None:
        self._wanted[address] = float("inf")  # while it is under way, and while it holds
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        connection.setblocking(False)
        status = connection.connect_ex(address)
        if status not in (0, errno.EINPROGRESS):
            connection.close()
            self._wanted[address] = time.monotonic() + RETRY_S
            return

        def connected() -> None:
            self._selector.unregister(connection)
            # A connection to the own port can meet itself while nobody listens (simultaneous open).
            if (
                connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
                or connection.getsockname() == address
            ):
                connection.close()
                self._wanted[address] = time.monotonic() + RETRY_S
            else:
                self._add(connection, address)

        self._selector.register(connection, selectors.EVENT_WRITE, connected)

    def _add(self, connection: socket.socket, address: Address | None) -> None:
        connection.setblocking(True)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer = _TcpPeer(connection)

        def serve() -> None:
            if not peer.read(self._deliver):
                self._selector.unregister(connection)
                self._connected = tuple(other for other in self._connected if other is not peer)
                connection.close()
                if address is not None:
                    self._wanted[address] = time.monotonic() + RETRY_S

        self._selector.register(connection, selectors.EVENT_READ, serve)
        self._connected += (peer,)
        peer.send(b"", self._own.to_bytes())

    def interrupt(self) -> None:
        """End the connections, so that a thread that waits in `send` goes on."""
        for peer in self._connected:
            peer.shut_down()

    def close(self) -> None:
        """Close all sockets; the thread that polls has ended."""
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._selector.close()


class _TcpPeer:
    """One connection: writing whole frames from any thread, reading them in whatever pieces they come."""

    def __init__(self, connection: socket.socket) -> None:
        self.greeting = Greeting()
        self._connection = connection
        self._writing = threading.Lock()
        self._header = bytearray(_TCP_HEADER.size)
        self._name = self._body = bytearray()
        self._open_part(self._header)

    def _open_part(self, part: bytearray) -> None:
        self._part = part
        self._left = memoryview(part)

    def send(self, topic: bytes, message: RawMessage) -> None:
        """A whole frame; on a connection that broke it is lost, and the reader notices."""
        parts = [_TCP_HEADER.pack(len(message), len(topic)) + topic, message]
        total = len(parts[0]) + len(message)
        with self._writing:
            try:
                sent = self._connection.sendmsg(parts)
                if sent < total:  # a signal came in between
                    self._connection.sendall(b"".join(parts)[sent:])
            except OSError:
                self.shut_down()

    def read(self, deliver: Callable[[str, bytearray], None]) -> bool:
        """Read until nothing more is there; False when the connection has ended."""
        while (is_whole := self._fill_part()) is True:
            if not self._end_part(deliver):
                return False
        return is_whole is None

    def _fill_part(self) -> bool | None:
        """True when the part is whole, None while more is to come, False when the connection has ended."""
        try:
            while self._left:
                count = self._connection.recv_into(self._left, 0, socket.MSG_DONTWAIT)
                if not count:
                    return False
                self._left = self._left[count:]
        except BlockingIOError:
            return None
        except OSError:
            return False
        return True

    def _end_part(self, deliver: Callable[[str, bytearray], None]) -> bool:
        """Go on to the next part of the frame, or hand the whole one on; False if it is none of ours."""
        if self._part is self._header:
            length, name_bytes = _TCP_HEADER.unpack(self._header)
            self._name, self._body = (
                bytearray(name_bytes),
                bytearray(length if length <= MAX_MESSAGE_BYTES else 0),
            )
            self._open_part(self._name)
            return bool(length <= MAX_MESSAGE_BYTES)
        if self._part is self._name:
            self._open_part(self._body)
            return True
        self._open_part(self._header)
        if self._name:
            deliver(self._name.decode(errors="replace"), self._body)
            return True
        greeting = Greeting.from_bytes(self._body)
        self.greeting = greeting or self.greeting
        return greeting is not None

    def shut_down(self) -> None:
        """End the connection in both directions; the reader then sees its end."""
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)


@dataclass
class _UdpPeer:
    """Somebody who greeted: when last, and the fragments of his messages that are not whole yet."""

    greeting: Greeting = field(default_factory=Greeting)
    heard_s: float = 0.0
    unfinished: dict[int, list[bytes | None]] = field(default_factory=dict)


class UdpLinks:
    """Datagrams to everybody who greets; a message with a lost fragment is lost. Arguments as for `TcpLinks`.

    Args:
        buffer_bytes: to ask of the kernel for each direction, None for its default.
    """

    def __init__(
        self,
        own: Greeting,
        listen: Address | None,
        peers: Sequence[Address],
        deliver: Callable[[str, bytearray], None],
        buffer_bytes: int | None = None,
    ) -> None:
        self._own = own
        self._deliver = deliver
        self._socket = _bound(socket.SOCK_DGRAM, listen or ("", 0))
        if buffer_bytes is not None:
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                self._socket.setsockopt(socket.SOL_SOCKET, option, buffer_bytes)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._buffer = memoryview(bytearray(1 << 16))
        self._number = 0
        self._numbering = threading.Lock()
        self._wanted = tuple(peers)
        self._peers: dict[Address, _UdpPeer] = {}
        self._next_greeting_s = 0.0

    @property
    def receive_buffer_bytes(self) -> int:
        """What the kernel gave, which counts its own bookkeeping twice (socket(7))."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def greetings(self) -> list[Greeting]:
        """Of those who greeted not long ago."""
        return [peer.greeting for peer in list(self._peers.values())]

    def announce(self) -> None:
        """Greet all peers, known and wanted."""
        for address in {*self._wanted, *self._peers}:
            self._send_to([address], b"", self._own.to_bytes())

    def send(self, topic: str, message: RawMessage) -> None:
        """Send a message in one or more datagrams to each subscriber."""
        takers = [
            address for address, peer in list(self._peers.items()) if topic in peer.greeting.subscriptions
        ]
        self._send_to(takers, topic.encode(), message)

    def _send_to(self, addresses: Sequence[Address], name: bytes, message: RawMessage) -> None:
        with self._numbering:
            self._number = number = (self._number + 1) % (1 << 32)
        count = max(-(-len(message) // FRAGMENT_BYTES), 1)
        with memoryview(message) as view:
            for index in range(count):
                header = _UDP_HEADER.pack(number, index, count, len(name)) + name
                part = view[index * FRAGMENT_BYTES : (index + 1) * FRAGMENT_BYTES]
                for address in addresses:
                    with suppress(OSError):  # no way there at the moment: lost, as on the way
                        self._socket.sendmsg([header, part], (), 0, address)

    def poll(self, timeout_s: float) -> None:
        """Greet now and then, and take what has arrived."""
        now_s = time.monotonic()
        if now_s >= self._next_greeting_s:
            met = set(self._wanted) <= set(self._peers)
            self._next_greeting_s = now_s + (GREETING_S if met else RETRY_S)
            for address, peer in list(self._peers.items()):
                if now_s - peer.heard_s > FORGET_S:
                    del self._peers[address]
            self.announce()
        self._selector.select(min(timeout_s, RETRY_S))
        with suppress(BlockingIOError):
            for _ in range(DATAGRAMS_A_ROUND):
                size, address = self._socket.recvfrom_into(self._buffer, 0, socket.MSG_DONTWAIT)
                self._take(self._buffer[:size], address)

    def _take(self, datagram: memoryview, address: Address) -> None:
        if len(datagram) < _UDP_HEADER.size:
            return
        number, index, count, name_bytes = _UDP_HEADER.unpack_from(datagram)
        begin = _UDP_HEADER.size + name_bytes
        if len(datagram) < begin or index >= count:
            return
        name, part = bytes(datagram[_UDP_HEADER.size : begin]).decode(errors="replace"), datagram[begin:]
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

    def _greeted(self, greeting: Greeting | None, address: Address) -> None:
        if greeting is None:
            return
        peer = self._peers.get(address)
        if peer is None:
            peer = self._peers[address] = _UdpPeer()
            self._send_to([address], b"", self._own.to_bytes())
        peer.greeting, peer.heard_s = greeting, time.monotonic()

    def interrupt(self) -> None:
        """Nothing: a datagram socket waits for nobody."""

    def close(self) -> None:
        """Close the socket; the thread that polls has ended."""
        self._selector.close()
        self._socket.close()


def _bound(kind: socket.SocketKind, address: Address) -> socket.socket:
    made = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:  # connections that ended a moment ago do not hold the port
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
    except OSError as err:
        made.close()
        raise OptionError(
            f"port {address[1]} cannot be opened ({err.strerror}); the backend socket has one relay for each domain "
            "of a device: end the other one, or choose another --domain"
        ) from err
    return made
