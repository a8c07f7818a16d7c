"""Frames over TCP connections, without Nagle's delay.

A thread for each connection waits in a blocking read, so that nothing lies between the kernel and the callback: a selector and
reads that do not block cost 80 to 120 us a message (`benchmarks/bench_node.py`). The callbacks run one at a time all the same.
"""

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
    from collections.abc import Callable, Sequence

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
        prepare: sets options of each connection's socket.
    """

    def __init__(
        self,
        own: Greeting,
        listen: Address | None,
        peers: Sequence[Address],
        deliver: Deliver,
        prepare: Callable[[socket.socket], None] = lambda _: None,
    ) -> None:
        self._own = own
        self._deliver_one = deliver
        self._prepare = prepare
        self._delivering = threading.Lock()
        self._error: BaseException | None = None  # of a callback
        self._selector = selectors.DefaultSelector()
        self._changing = threading.Lock()
        self._connected: tuple[_TcpPeer, ...] = ()
        self._closing = False
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
        """Make and accept connections for one round; raise the error of a callback."""
        if self._error is not None:
            raise self._error
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
        self._prepare(connection)
        peer = _TcpPeer(connection)
        with self._changing:
            if self._closing:
                connection.close()
                return
            self._connected += (peer,)
        peer.send(b"", self._own.to_bytes())
        name = f"{threading.current_thread().name}-{connection.fileno()}"
        peer.thread = threading.Thread(target=self._serve, args=(peer, address), name=name, daemon=True)
        peer.thread.start()

    def _serve(self, peer: _TcpPeer, address: Address | None) -> None:
        """Read from one connection until it ends; its thread runs this."""
        try:
            peer.read(self._deliver)
        except BaseException as error:  # noqa: BLE001 - a callback's, for the node's thread; this one has no caller
            self._error = self._error or error
        with self._changing:
            self._connected = tuple(other for other in self._connected if other is not peer)
        peer.close()
        if address is not None:
            self._wanted[address] = time.monotonic() + RETRY_S

    def _deliver(self, topic: str, message: bytearray) -> None:
        with self._delivering:  # several pings at one relay
            if self._error is None:
                self._deliver_one(topic, message)

    def interrupt(self) -> None:
        """End the connections, so that a thread that waits in `send` goes on, and no callback runs any more."""
        with self._changing:
            self._closing = True
            peers = self._connected
        for peer in peers:
            peer.shut_down()
        for peer in peers:
            if peer.thread is not None:
                peer.thread.join()

    def close(self) -> None:
        """Close all sockets; the thread that polls has ended."""
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._selector.close()


class _TcpPeer:
    """One connection: writing whole frames from any thread, reading them on a thread of its own."""

    def __init__(self, connection: socket.socket) -> None:
        self.greeting = Greeting()
        self.thread: threading.Thread | None = None
        self._connection = connection
        self._writing = threading.Lock()

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

    def read(self, deliver: Deliver) -> None:
        """Hand on each frame until the connection ends, or brings something that is no frame of ours.

        The messages of a run are alike, so each read expects a frame like the last one and finds memory made for it: such a
        frame is one call of the kernel, and nothing is copied.
        """
        expected, topic, body_bytes = b"", "", 0
        while True:
            head, body = bytearray(len(expected) or _HEADER.size), bytearray(body_bytes)
            try:
                count = self._connection.recvmsg_into((head, body))[0]
            except OSError:
                return
            if count >= len(head) and head == expected:
                missing = len(head) + body_bytes - count
                if missing and not self._fill(memoryview(body)[-missing:]):
                    return
                deliver(topic, body)
                continue
            if not count:
                return
            begun = memoryview(head + body)[:count]
            while begun:
                frame = self._read_frame(begun)
                if frame is None:
                    return
                expected, topic, body, begun = frame
                body_bytes = len(body)
                if topic:
                    deliver(topic, body)
                elif not self._greeted(body):
                    return

    def _read_frame(self, begun: memoryview) -> tuple[bytes, str, bytearray, memoryview] | None:
        """Read a frame of which `begun` has arrived; return its head, topic, message, and what is left of `begun`.

        Returns:
            None when the connection has ended, or brought no frame of ours.
        """
        parts: list[bytearray] = []
        sizes = [_HEADER.size]
        while sizes:
            part = bytearray(sizes.pop())
            there = begun[: len(part)]
            part[: len(there)] = there
            begun = begun[len(there) :]
            if not self._fill(memoryview(part)[len(there) :]):
                return None
            if not parts:
                body_bytes, name_bytes = _HEADER.unpack(part)
                if body_bytes > MAX_MESSAGE_BYTES:
                    return None
                sizes = [body_bytes, name_bytes]
            parts.append(part)
        header, name, body = parts
        return bytes(header + name), name.decode(errors="replace"), body, begun

    def _fill(self, left: memoryview) -> bool:
        """Read until `left` is full; return False when the connection has ended."""
        try:
            while left:
                count = self._connection.recv_into(left)
                if not count:
                    return False
                left = left[count:]
        except OSError:
            return False
        return True

    def _greeted(self, body: bytearray) -> bool:
        """Keep a greeting; return False if `body` is none."""
        greeting = Greeting.from_bytes(body)
        self.greeting = greeting or self.greeting
        return greeting is not None

    def shut_down(self) -> None:
        """End the connection in both directions; the reader then sees its end."""
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the socket, which nobody reads any more."""
        self.shut_down()
        with self._writing:  # no send may meet another file under the same number
            self._connection.close()
