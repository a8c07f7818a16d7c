"""`socket`: plain TCP or UDP without a middleware (docs/reference/middlewares.md); the relay listens, the ping connects."""

from __future__ import annotations

import platform
import socket
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

from ...applied.vendors import BUFFER_BYTES
from ...choices import Discovery, Reliability, Security, Transport
from ...security.tls import TlsSocket, tls_context, unlike_tls
from ..base import Backend, Meeting
from ..node import Endpoint, Middleware, NodeSubscription, ThreadedNode, TopicView
from ..qos import refuse_policies
from .greeting import Greeting
from .tcp import TcpLinks
from .udp import UdpLinks

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from dds_trace.tracefile.format.descriptions import Qos

    from ..node import Node, NodeOptions, Publisher, RawMessage, Receive, Subscription
    from .greeting import Address

ALLOWED_CONGESTION_CONTROL = Path("/proc/sys/net/ipv4/tcp_allowed_congestion_control")
"""Algorithms that a process without CAP_NET_ADMIN may choose."""

_CONGESTION_NAME_BYTES = 16  # TCP_CA_NAME_MAX of linux/tcp.h

PROTOCOLS = {Transport.DEFAULT: "tcp", Transport.UDP: "udp"}


class SocketNode(ThreadedNode):
    """One role's connections; `port` is a relay's (0: any free port), `peers` are the relays of a ping."""

    def __init__(self, options: NodeOptions, port: int, peers: Sequence[Address]) -> None:
        super().__init__(options)
        _check_qos(options.qos, PROTOCOLS[options.transport])
        self._peers = peers
        self._receivers: dict[str, tuple[Receive[RawMessage], ...]] = {}
        self._greeting = Greeting(options.name)
        is_local = options.discovery is Discovery.LOCALHOST
        listen = ("127.0.0.1" if is_local else "", port) if options.listens else None
        resolved = [_resolve(address) for address in peers]
        settings = {
            "protocol": PROTOCOLS[options.transport],
            "discovery": options.discovery.value,
            "port": str(port),
            "tuned": str(options.tuned).lower(),
        }
        self._links: TcpLinks | UdpLinks
        if options.transport is Transport.UDP:
            if options.security is not Security.OFF:
                raise OptionError(f"-o security={options.security.value}: TLS is for TCP; leave -o transport=udp out")
            if options.congestion_control is not None:
                raise OptionError(f"-o congestion_control={options.congestion_control}: UDP has none; leave it out")
            buffer_bytes = options.buffer_bytes or (BUFFER_BYTES if options.tuned else None)
            links = UdpLinks(
                self._greeting, listen, resolved, self._receivers, self.strangers, buffer_bytes, options.fragment_bytes
            )
            settings["receive_buffer_bytes"] = str(links.receive_buffer_bytes)
            self._links = links
        else:
            prepare = partial(prepare_connection, name=options.congestion_control, buffer_bytes=options.buffer_bytes)
            with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as trial:
                settings["congestion_control"] = prepare(trial)
            secure = None
            if options.keys is not None:
                context = tls_context(options.keys, listens=options.listens)
                secure = partial(TlsSocket, context=context, listens=options.listens)
            self._links = TcpLinks(self._greeting, listen, resolved, self._receivers, prepare, self.strangers, secure)
            if options.tuned:
                settings["tuned"] = "nothing to tune: the kernel sizes the buffers of TCP itself"
        self._middleware = Middleware("socket", "socket", None, {"kernel": platform.release()}, settings)

    @property
    def port(self) -> int:
        return self._links.port

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RawMessage]:
        _check_qos(qos or self.options.qos, PROTOCOLS[self.options.transport])
        self._greeting.publishers = {**self._greeting.publishers, topic: type_name}
        self._links.announce()
        return _SocketPublisher(self._links.sender(topic), partial(self._withdraw_publisher, topic))

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        _check_qos(qos or self.options.qos, PROTOCOLS[self.options.transport])
        self._receivers[topic] = (*self._receivers.get(topic, ()), receive)
        self._greeting.subscriptions = {**self._greeting.subscriptions, topic: type_name}
        self._links.announce()
        return NodeSubscription(partial(self._withdraw_subscription, topic, receive))

    def _withdraw_publisher(self, topic: str) -> None:
        self._greeting.publishers = _without(self._greeting.publishers, topic)
        self._links.announce()

    def _withdraw_subscription(self, topic: str, receive: Receive[RawMessage]) -> None:
        self._receivers[topic] = tuple(other for other in self._receivers[topic] if other is not receive)
        if not self._receivers[topic]:
            self._greeting.subscriptions = _without(self._greeting.subscriptions, topic)
            self._links.announce()

    def read_security(self) -> str:
        return self._links.security if isinstance(self._links, TcpLinks) else ""

    def explain_security(self) -> str:
        if self.options.transport is Transport.UDP:
            return ""
        return unlike_tls(self._peers, is_secured=self.options.keys is not None)

    def _make_round(self) -> Callable[[], None]:
        return self._links.poll

    def look_at(self, topic: str) -> TopicView:
        greetings = [self._greeting, *self._links.greetings()]
        return TopicView(
            topic,
            tuple(Endpoint(node.name, node.publishers[topic]) for node in greetings if topic in node.publishers),
            tuple(Endpoint(node.name, node.subscriptions[topic]) for node in greetings if topic in node.subscriptions),
        )

    def count_participants(self) -> int | None:
        return 1 + len(self._links.greetings())

    def _wake(self) -> None:
        self._links.interrupt()

    def _leave(self) -> None:
        self._links.close()


@dataclass(frozen=True, slots=True)
class _SocketPublisher:
    publish: Callable[[RawMessage], None]
    close: Callable[[], None]


def _without(mapping: dict[str, str], key: str) -> dict[str, str]:
    return {name: value for name, value in mapping.items() if name != key}


def _check_qos(qos: Qos, protocol: str) -> None:
    refuse_policies("socket", qos, "sockets keep no messages for late subscriptions")
    if protocol == "udp" and qos.reliability != Reliability.BEST_EFFORT:
        raise OptionError(
            "-o transport=udp: plain UDP does not retransmit; give --reliability best_effort on both sides"
        )


def _resolve(address: tuple[str, int]) -> tuple[str, int]:
    host, port = address
    try:
        return socket.gethostbyname(host), port
    except OSError as err:
        raise OptionError(f"--peer {host}: no IPv4 address is known for it ({err})") from err


def prepare_connection(connection: socket.socket, name: str | None, buffer_bytes: int | None) -> str:
    if buffer_bytes is not None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, buffer_bytes)
    if name is not None:
        try:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, name.encode())
        except OSError as err:
            allowed = sorted(ALLOWED_CONGESTION_CONTROL.read_text().split())
            raise OptionError(
                f"-o congestion_control={name}: the kernel refuses it ({err.strerror}); it allows {', '.join(allowed)}"
            ) from err
    read = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, _CONGESTION_NAME_BYTES)
    return read.rstrip(b"\0").decode("ascii", "replace")


def _make_node(options: NodeOptions) -> Node:
    peers = () if options.listens else BACKEND.peer_addresses(options)
    return SocketNode(options, BACKEND.port_of(options.domain_id), peers)


def _make_pair(options: NodeOptions) -> tuple[Node, Node]:
    local = replace(options, discovery=Discovery.LOCALHOST, peers=())
    if options.transport is Transport.UDP:
        local = replace(local, qos=replace(options.qos, reliability=Reliability.BEST_EFFORT))
    subscribes = SocketNode(replace(local, listens=True), 0, ())
    try:
        return subscribes, SocketNode(replace(local, listens=False), 0, [("127.0.0.1", subscribes.port)])
    except BaseException:
        subscribes.close()
        raise


BACKEND = Backend(
    name="socket",
    label="Socket",
    make_node=_make_node,
    find_installed=lambda: [None],
    install="it needs nothing",
    meeting=Meeting.PEERS,
    meeting_needs=(
        "both have --backend socket and the same --domain and -o transport, --peer names the relay's device, and nothing "
        "blocks its port {port}"
    ),
    relay_port=8,
    make_pair=_make_pair,
    has_congestion_control=True,
    transports=tuple(PROTOCOLS),
    security=(Security.ENCRYPT_RTPS,),
    sizes={Transport.DEFAULT: ("buffer",), Transport.UDP: ("buffer", "fragment")},
)
