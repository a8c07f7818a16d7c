"""`socket`: plain TCP or UDP, the floor that no middleware can beat on this link.

The relay listens at a port that follows from the domain, the ping connects. `--transport default` is TCP without
Nagle's delay, `udp` is UDP with fragments of 60 KB and nothing sent again. See `docs/middlewares.md`.
"""

from __future__ import annotations

import platform
import socket
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import OptionError, Qos

from .base import Discovery, Endpoint, Middleware, TopicView, Transport
from .checks import (
    SOCKET_PORT,
    peer_addresses,
    port_of,
    refuse_durations,
    refuse_others_options,
    refuse_typed,
)
from .socket_links import TUNED_BUFFER_BYTES, Greeting, TcpLinks, UdpLinks

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from .base import (
        Node,
        NodeOptions,
        Publisher,
        RawMessage,
        Receive,
        Subscription,
    )

POLL_S = 0.1
"""One round of the thread; how long `close` may have to wait for it."""

PROTOCOLS = {Transport.DEFAULT: "tcp", Transport.UDP: "udp"}


class SocketBackend:
    """TCP and UDP; see `Backend` for the names."""

    name = "socket"

    def open_node(self, options: NodeOptions) -> Node:
        """A node that listens (a relay) or connects (a ping)."""
        refuse_others_options(self.name, options, PROTOCOLS)
        _check_qos(options.qos, PROTOCOLS[options.transport])
        return SocketNode(options)


BACKEND = SocketBackend()


class SocketNode:
    """The connections of one role with their thread; see `Node` for the names."""

    def __init__(self, options: NodeOptions) -> None:
        self._options = options
        self._receivers: dict[str, tuple[Receive, ...]] = {}
        self._own = Greeting(options.name)
        port = port_of(options.domain_id, SOCKET_PORT)
        is_local = options.discovery is Discovery.LOCALHOST
        listen = ("127.0.0.1" if is_local else "", port) if options.listens else None
        wanted = () if options.listens else peer_addresses("socket", options, port)
        peers = [_resolved(address) for address in wanted]
        settings = {
            "protocol": PROTOCOLS[options.transport],
            "discovery": options.discovery.value,
            "port": str(port),
            "tuned": str(options.tuned).lower(),
        }
        self._links: TcpLinks | UdpLinks
        if options.transport is Transport.UDP:
            self._links = UdpLinks(
                self._own, listen, peers, self._deliver, TUNED_BUFFER_BYTES if options.tuned else None
            )
            settings["receive_buffer_bytes"] = str(self._links.receive_buffer_bytes)
        else:
            self._links = TcpLinks(self._own, listen, peers, self._deliver)
            if options.tuned:
                settings["tuned"] = "nothing to tune: the kernel sizes the buffers of TCP itself"
        self._middleware = Middleware("socket", "socket", None, {"kernel": platform.release()}, settings)
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._error: BaseException | None = None

    @property
    def options(self) -> NodeOptions:
        """What the node was opened with."""
        return self._options

    @property
    def middleware(self) -> Middleware:
        """What carries the messages."""
        return self._middleware

    def create_publisher(
        self, topic: str, type_name: str, *, qos: Qos | None = None, typed: bool = False
    ) -> Publisher:
        """A publisher of bytes."""
        refuse_typed("socket", typed)
        _check_qos(qos or self._options.qos, PROTOCOLS[self._options.transport])
        self._own.publishers = {**self._own.publishers, topic: type_name}
        self._links.announce()
        return _SocketPublisher(topic, self._links.send, self._withdraw_publisher)

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive, *, qos: Qos | None = None, typed: bool = False
    ) -> Subscription:
        """A subscription of bytes."""
        refuse_typed("socket", typed)
        _check_qos(qos or self._options.qos, PROTOCOLS[self._options.transport])
        self._receivers[topic] = (*self._receivers.get(topic, ()), receive)
        self._own.subscriptions = {**self._own.subscriptions, topic: type_name}
        self._links.announce()
        return _SocketSubscription(topic, receive, self._withdraw_subscription)

    def _withdraw_publisher(self, topic: str) -> None:
        self._own.publishers = _without(self._own.publishers, topic)
        self._links.announce()

    def _withdraw_subscription(self, topic: str, receive: Receive) -> None:
        self._receivers[topic] = tuple(each for each in self._receivers[topic] if each is not receive)
        if not self._receivers[topic]:
            self._own.subscriptions = _without(self._own.subscriptions, topic)
            self._links.announce()

    def message_from_cdr(self, type_name: str, data: RawMessage) -> Any:
        """There are no message objects."""
        del type_name, data
        refuse_typed("socket", True)

    def start(self) -> None:
        """Start the thread that reads."""
        self._thread = threading.Thread(target=self._poll, name=f"socket-domain-{self._options.domain_id}")
        self._thread.daemon = True
        self._thread.start()

    def _poll(self) -> None:
        try:
            while not self._stopping:
                self._links.poll(POLL_S)
        except BaseException as error:  # noqa: BLE001 - kept for whoever looks at the node; a thread has no caller
            self._error = error

    def _deliver(self, topic: str, message: bytearray) -> None:
        for receive in self._receivers.get(topic, ()):
            receive(message)

    @property
    def error(self) -> BaseException | None:
        """What ended the thread."""
        return self._error

    def look_at(self, topic: str) -> TopicView:
        """The own endpoints and those that the peers told of."""
        greetings = [self._own, *self._links.greetings()]
        return TopicView(
            topic,
            tuple(
                Endpoint(each.name, each.publishers[topic]) for each in greetings if topic in each.publishers
            ),
            tuple(
                Endpoint(each.name, each.subscriptions[topic])
                for each in greetings
                if topic in each.subscriptions
            ),
        )

    def count_participants(self) -> int | None:
        """This node and its peers."""
        return 1 + len(self._links.greetings())

    def close(self) -> None:
        """Stop the thread and end the connections; the kernel still sends what it holds."""
        if self._stopping:
            return
        self._stopping = True
        self._links.interrupt()
        if self._thread is not None:
            self._thread.join()
        self._links.close()

    def __enter__(self) -> SocketNode:  # noqa: PYI034 - `Self` is Python 3.11's
        """The node itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()


@dataclass(frozen=True, slots=True)
class _SocketPublisher:
    """Publishes serialized messages."""

    topic: str
    send: Callable[[str, RawMessage], None]
    withdraw: Callable[[str], None]

    def publish(self, message: RawMessage, /) -> None:
        self.send(self.topic, message)

    def close(self) -> None:
        self.withdraw(self.topic)


@dataclass(frozen=True, slots=True)
class _SocketSubscription:
    topic: str
    receive: Receive
    withdraw: Callable[[str, Receive], None]

    def close(self) -> None:
        self.withdraw(self.topic, self.receive)


def _without(mapping: dict[str, str], key: str) -> dict[str, str]:
    return {name: value for name, value in mapping.items() if name != key}


def _check_qos(qos: Qos, protocol: str) -> None:
    refuse_durations("socket", qos)
    if qos.durability != "volatile":
        raise OptionError(f"--durability {qos.durability}: sockets keep no message for those who come later")
    if protocol == "udp" and qos.reliability != "best_effort":
        raise OptionError(
            "--transport udp: plain UDP sends nothing again; give --reliability best_effort on both sides"
        )


def _resolved(address: tuple[str, int]) -> tuple[str, int]:
    host, port = address
    try:
        return socket.gethostbyname(host), port
    except OSError as err:
        raise OptionError(f"--peer {host}: no IPv4 address is known for it ({err})") from err
