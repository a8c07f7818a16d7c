"""Frames over TCP connections, without Nagle's delay.

A thread for each connection blocks in its read: a selector costs 80 to 120 us (`benchmarks/bench_node.py`); callbacks take turns.
"""

from __future__ import annotations

import errno
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable, Container, Sequence
from contextlib import suppress

from dds_trace.base.threads import FastLock

from ...security.tls import TlsSocket
from ..node import ROUND_S, RawMessage
from ..other_side import Strangers
from .greeting import (
    CROWD,
    HALF_OPEN,
    MALFORMED,
    MAX_GREETING_BYTES,
    MAX_MESSAGE_BYTES,
    MAX_PEERS,
    MEMORY_BYTES,
    RETRY_S,
    SLOW,
    TOO_LARGE,
    UNSECURED,
    Address,
    Greeting,
    PeerError,
    Receivers,
    bound_socket,
    is_own_address,
    timeval,
)

HALF_OPEN_S = 5.0
READER_PATIENCE_S = 0.25
"""Longest wait for a subscriber that only reads along."""
SENDER_PATIENCE_S = 1.0
"""Longest wait for one that sends messages, in which it must take `LEAST_READ_BYTES`."""
LEAST_READ_BYTES = 16_384
PIECE_BYTES = 1 << 20
"""Memory grows by as much as has arrived and this: a header may claim anything."""

_HEADER = struct.Struct("<IH")  # bytes of the message, bytes of the topic's name; then name and message


class TcpLinks:
    """Connections to peers, and from peers; `prepare` sets the options of each socket, `secure` shakes hands."""

    def __init__(
        self,
        greeting: Greeting,
        listen: Address | None,
        peers: Sequence[Address],
        receivers: Receivers,
        prepare: Callable[[socket.socket], object],
        strangers: Strangers,
        secure: Callable[[socket.socket], TlsSocket] | None = None,
    ) -> None:
        self.security, self._secure = "", secure  # the latest secured connection in words
        self._handshakes = threading.Semaphore(MAX_PEERS)
        self._strangers = strangers
        self._greeting = greeting
        self._receivers = receivers
        self._prepare = prepare
        self._delivering = FastLock()
        self._error: BaseException | None = None  # of a callback
        self._selector = selectors.DefaultSelector()
        self._changing = threading.Lock()
        self._connected: tuple[_TcpPeer, ...] = ()
        self._closing = False
        self._retry_s: dict[Address, float] = dict.fromkeys(peers, 0.0)  # time of the next attempt
        self._listener = None
        if listen is not None:
            self._listener = bound_socket(socket.SOCK_STREAM, listen)
            self._listener.listen()
            self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    @property
    def port(self) -> int:
        return 0 if self._listener is None else int(self._listener.getsockname()[1])

    def greetings(self) -> list[Greeting]:
        return [peer.greeting for peer in self._connected]

    def announce(self) -> None:
        for peer in self._connected:
            peer.greet(self._greeting)

    def sender(self, topic: str) -> Callable[[RawMessage], None]:
        name, length, head = topic.encode(), -1, b""

        # Between the stamp and the kernel: few calls, little memory.
        def send(message: RawMessage) -> None:
            nonlocal length, head
            if len(message) != length:
                length = len(message)
                head = _head(name, length)
            for peer in self._connected:
                if topic in peer.topics:
                    peer.send(head, message)

        return send

    def poll(self) -> None:
        if self._error is not None:
            raise self._error
        now_s = time.monotonic()
        for address, next_s in list(self._retry_s.items()):
            if now_s >= next_s:
                self._connect(address)
        for peer in self._connected:
            if not peer.has_greeted and now_s - peer.since_s > HALF_OPEN_S:
                self._drop(peer, HALF_OPEN)
            if peer.is_chosen and not is_own_address(peer.own_host):  # TCP would try for a quarter of an hour
                peer.shut_down()
        for key, _ in self._selector.select(ROUND_S):
            key.data()

    def _accept(self) -> None:
        """Accept a connection; of too many the oldest without a greeting ends, else this one."""
        assert self._listener is not None
        try:
            connection, _ = self._listener.accept()
        except OSError:  # it ended meanwhile, or this process has no more files
            self._strangers.count(CROWD)
            time.sleep(ROUND_S)
            return
        peers = self._connected
        if len(peers) >= MAX_PEERS:
            silent = next((peer for peer in peers if not peer.has_greeted), None)
            if silent is None:
                connection.close()
                self._strangers.count(CROWD)
                return
            self._drop(silent, CROWD)
            self._remove(silent)
        self._add(connection, None)

    def _drop(self, peer: _TcpPeer, kind: str) -> None:
        self._strangers.count(kind)
        peer.shut_down()

    def _remove(self, peer: _TcpPeer) -> None:
        with self._changing:
            self._connected = tuple(other for other in self._connected if other is not peer)

    def _connect(self, address: Address) -> None:
        self._retry_s[address] = float("inf")  # while it connects and is connected
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        connection.setblocking(False)
        if connection.connect_ex(address) not in (0, errno.EINPROGRESS):
            connection.close()
            self._retry(address)
            return

        def connected() -> None:
            self._selector.unregister(connection)
            # While nobody listens, a connection to a local port can connect to itself.
            if connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) or connection.getsockname() == address:
                connection.close()
                self._retry(address)
            else:
                self._add(connection, address)

        self._selector.register(connection, selectors.EVENT_WRITE, connected)

    def _add(self, connection: socket.socket, address: Address | None) -> None:
        connection.setblocking(True)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._prepare(connection)
        if self._secure is None:
            self._join(connection, address)
        elif self._handshakes.acquire(blocking=False):
            threading.Thread(target=self._shake_hands, args=(connection, address), daemon=True).start()
        else:
            connection.close()
            self._strangers.count(CROWD)

    def _shake_hands(self, connection: socket.socket, address: Address | None) -> None:
        assert self._secure is not None
        try:
            secured = self._secure(connection)
        except OSError:
            self._strangers.count(UNSECURED)
            connection.close()
            self._retry(address)
        else:
            self.security = secured.describe()
            self._join(secured, address)
        finally:
            self._handshakes.release()

    def _join(self, connection: socket.socket | TlsSocket, address: Address | None) -> None:
        peer = _TcpPeer(connection, self._has_memory, is_chosen=address is not None)
        peer.greet(self._greeting)
        name = f"{threading.current_thread().name}-{connection.fileno()}"
        peer.thread = threading.Thread(target=self._serve, args=(peer, address), name=name, daemon=True)
        with self._changing:  # `interrupt` joins the threads of the peers that it sees: each has started
            if self._closing:
                connection.close()
                return
            try:
                peer.thread.start()
            except RuntimeError:  # this process has no more threads
                connection.close()
                self._strangers.count(CROWD)
                self._retry(address)
                return
            self._connected += (peer,)

    def _serve(self, peer: _TcpPeer, address: Address | None) -> None:
        try:
            peer.read(self._receivers, self._delivering)
        except (PeerError, MemoryError) as error:
            self._strangers.count(TOO_LARGE if isinstance(error, MemoryError) else str(error))
        except BaseException as error:  # noqa: BLE001 - a callback's; `poll` raises it
            self._error = self._error or error
        if peer.is_slow:
            self._strangers.count(SLOW)
        self._remove(peer)
        peer.close()
        self._retry(address)

    def _retry(self, address: Address | None) -> None:
        if address is not None:
            self._retry_s[address] = time.monotonic() + RETRY_S

    def _has_memory(self, peer: _TcpPeer, size: int) -> bool:
        return size + sum(other.frame_bytes for other in self._connected if other is not peer) <= MEMORY_BYTES

    def interrupt(self) -> None:
        """End the connections: a blocked `send` returns, and no callback runs any more."""
        with self._changing:
            self._closing = True
            peers = self._connected
        for peer in peers:
            peer.shut_down()
        for peer in peers:
            if peer.thread is not None:
                peer.thread.join()

    def close(self) -> None:
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._selector.close()


def _head(topic: bytes, message_bytes: int) -> bytes:
    return _HEADER.pack(message_bytes, len(topic)) + topic


def _deliver(
    frames: list[tuple[bytes, str, bytearray]], receivers: Receivers, delivering: FastLock
) -> tuple[bytes, str, int]:
    for _, topic, message in frames:
        with delivering:
            for receive in receivers.get(topic, ()):
                receive(message)
    head, topic, message = frames[-1] if frames else (b"", "", bytearray())
    return head, topic, len(head) + len(message)


class _TcpPeer:
    """One connection: any thread writes frames, its own reads them; one that the user chose is waited for without end."""

    def __init__(
        self, connection: socket.socket | TlsSocket, has_memory: Callable[[_TcpPeer, int], bool], *, is_chosen: bool
    ) -> None:
        self.since_s, self.own_host = time.monotonic(), connection.getsockname()[0] if is_chosen else ""
        self.has_greeted = self.is_slow = self._has_sent = False
        self.frame_bytes = 0  # of the frame that it sends
        self._has_memory = has_memory
        self.is_chosen = is_chosen
        self.greeting = Greeting()
        self.topics: Container[str] = ()  # its subscriptions
        self.thread: threading.Thread | None = None
        self._connection = connection
        self._send, self._receive = connection.sendmsg, connection.recv_into
        self._writing = FastLock()
        self._take, self._give = self._writing.take, self._writing.give
        if not is_chosen:
            self._be_patient(READER_PATIENCE_S)

    def _be_patient(self, wait_s: float) -> None:
        self._connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, timeval(wait_s))

    def greet(self, greeting: Greeting) -> None:
        text = greeting.to_bytes()
        self.send(_head(b"", len(text)), text)

    def send(self, head: bytes, message: RawMessage) -> None:
        """Send a frame; on a broken connection it is lost, and the reader sees the end."""
        try:
            self._take()
        except IndexError:
            self._writing.wait()
        try:
            sent = self._send((head, message))
            if sent < len(head) + len(message):  # a signal interrupted it, or the peer is slow
                self._send_rest(memoryview(head + message)[sent:])
        except BlockingIOError:
            self.is_slow = True
            self.shut_down()
        except OSError:
            self.shut_down()
        finally:
            self._give(None)
            if self._writing.is_awaited:
                self._writing.wake()

    def _send_rest(self, remainder: memoryview) -> None:
        while remainder:
            began_s = time.monotonic()
            sent = self._connection.send(remainder)
            remainder = remainder[sent:]
            waited_s = time.monotonic() - began_s
            is_late = waited_s > (SENDER_PATIENCE_S if self._has_sent else READER_PATIENCE_S) / 2
            if remainder and not self.is_chosen and is_late and sent < LEAST_READ_BYTES:
                raise BlockingIOError

    def read(self, receivers: Receivers, delivering: FastLock) -> None:
        """Deliver each frame until the end, into memory for one like the last: one call of the kernel and no copy."""
        receive_into, take, give = self._receive, delivering.take, delivering.give
        head, topic, head_bytes, expected_bytes = b"", "", 0, 0  # 0: nothing is expected
        while True:
            message = bytearray(expected_bytes or _HEADER.size)
            try:
                count = receive_into(message)
            except OSError:
                return
            if head_bytes and count >= head_bytes and message.startswith(head):
                if count < expected_bytes and not self._fill(memoryview(message)[count:]):
                    return
                del message[:head_bytes]  # moves the buffer's start and copies nothing
                try:
                    take()
                except IndexError:
                    delivering.wait()
                try:
                    for receive in receivers.get(topic, ()):
                        receive(message)
                finally:
                    give(None)
                    if delivering.is_awaited:
                        delivering.wake()
                continue
            frames = self._read_frames(memoryview(message)[:count])
            if frames is None:
                return
            head, topic, expected_bytes = _deliver(frames, receivers, delivering)
            head_bytes = len(head)

    def _read_frames(self, data: memoryview) -> list[tuple[bytes, str, bytearray]] | None:
        """Complete the frames that start in `data`; return head, topic and message of each, None at the end. A `PeerError` for one that is broken, or before the greeting."""
        frames = []
        if not data:
            return None
        while data:
            frame = self._read_frame(data)
            if frame is None:
                return None
            head, topic, message, data = frame
            if topic:
                frames.append((head, topic, message))
            else:
                self._take_greeting(message)
        if frames and not self._has_sent:
            self._has_sent = True
            if not self.is_chosen:
                self._be_patient(SENDER_PATIENCE_S)
        return frames

    def _read_frame(self, data: memoryview) -> tuple[bytes, str, bytearray, memoryview] | None:
        parts: list[bytearray] = []
        sizes = [_HEADER.size]
        while sizes:
            size = sizes.pop()
            part = bytearray(data[:size])
            data = data[len(part) :]
            while len(part) < size:  # doubled: what arrived is copied once more at most
                start = len(part)
                part += bytes(min(size - start, max(start, PIECE_BYTES)))
                with memoryview(part) as view:
                    if not self._fill(view[start:]):
                        return None
            if not parts:
                body_bytes, name_bytes = _HEADER.unpack(part)
                most = MAX_MESSAGE_BYTES if self.has_greeted and name_bytes else MAX_GREETING_BYTES
                if body_bytes > most or (name_bytes and not self.has_greeted):
                    raise PeerError(MALFORMED)
                if not self._has_memory(self, body_bytes):
                    raise PeerError(TOO_LARGE)
                self.frame_bytes = body_bytes
                sizes = [body_bytes, name_bytes]
            parts.append(part)
        header, name, body = parts
        return bytes(header + name), name.decode(errors="replace"), body, data

    def _fill(self, remainder: memoryview) -> bool:
        try:
            while remainder:
                count = self._connection.recv_into(remainder)
                if not count:
                    return False
                remainder = remainder[count:]
        except OSError:
            return False
        return True

    def _take_greeting(self, body: bytearray) -> None:
        greeting = Greeting.from_bytes(body)
        if greeting is None:
            raise PeerError(MALFORMED)
        self.greeting, self.topics = greeting, frozenset(greeting.subscriptions)
        self.has_greeted = True

    def shut_down(self) -> None:
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.shut_down()
        with self._writing:  # no send may use the number of another file
            self._connection.close()
