"""Frames over TCP connections, without Nagle's delay."""

from __future__ import annotations

import errno
import selectors
import socket
import struct
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from .links import RETRY_S, Greeting, bound_socket

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..node import RawMessage
    from .links import Address, Deliver

MAX_MESSAGE_BYTES = 1 << 30
"""Largest message; a header with a greater length is no frame of ours."""

_HEADER = struct.Struct("<IH")  # bytes of the message, bytes of the topic's name; then name and message


class TcpLinks:
    """Connections to peers, kept up, and from peers, on one listening socket.

    Args:
        own: the node's own greeting, sent to each new peer.
        listen: address at which connections are accepted, None for none.
        peers: addresses to connect to, again and again until it works.
        deliver: callback that takes the topic and the message of each frame.
    """

    def __init__(
        self,
        own: Greeting,
        listen: Address | None,
        peers: Sequence[Address],
        deliver: Deliver,
    ) -> None:
        self._own = own
        self._deliver = deliver
        self._selector = selectors.DefaultSelector()
        self._connected: tuple[_TcpPeer, ...] = ()
        self._wanted: dict[Address, float] = dict.fromkeys(peers, 0.0)  # -> when to try again
        self._listener = None
        if listen is not None:
            self._listener = bound_socket(socket.SOCK_STREAM, listen)
            self._listener.listen()
            self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def greetings(self) -> list[Greeting]:
        """Return the greetings of the connected peers."""
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
        self._header = bytearray(_HEADER.size)
        self._name = self._body = bytearray()
        self._open_part(self._header)

    def _open_part(self, part: bytearray) -> None:
        self._part = part
        self._left = memoryview(part)

    def send(self, topic: bytes, message: RawMessage) -> None:
        """Send a whole frame; on a connection that broke it is lost, and the reader notices."""
        parts = [_HEADER.pack(len(message), len(topic)) + topic, message]
        total = len(parts[0]) + len(message)
        with self._writing:
            try:
                sent = self._connection.sendmsg(parts)
                if sent < total:  # a signal came in between
                    self._connection.sendall(b"".join(parts)[sent:])
            except OSError:
                self.shut_down()

    def read(self, deliver: Deliver) -> bool:
        """Read until nothing more is there; return False when the connection has ended."""
        while (is_whole := self._fill_part()) is True:
            if not self._end_part(deliver):
                return False
        return is_whole is None

    def _fill_part(self) -> bool | None:
        """Read on; return True when the part is whole, None while more is to come, False when the connection has ended."""
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

    def _end_part(self, deliver: Deliver) -> bool:
        """Go on to the next part of the frame, or hand the whole one on; return False if it is no frame of ours."""
        if self._part is self._header:
            length, name_bytes = _HEADER.unpack(self._header)
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
