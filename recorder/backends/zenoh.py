"""`zenoh`: eclipse-zenoh, peer to peer (docs/reference/middlewares.md). Only this file imports zenoh."""

# ruff: noqa: PLC0415 - loaded with a node: other backends run without it

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from typing import TYPE_CHECKING, Any

from dds_trace.base.errors import OptionError

from ..choices import Call, Discovery, Reliability, Security, Transport, WhenFull
from ..host.environment import ConfigurationVariable, MiddlewareEnvironment
from ..security.tls import unlike_tls, zenoh_tls
from .base import Backend, Meeting, has_package
from .dds_types import DDS_TYPES
from .node import RELAY_SUFFIX, Endpoint, Middleware, Node, NodeSubscription, Publication, TopicView
from .qos import refuse_policies
from .sizes import LEAST_RESPONSE_BYTES, requested_bytes
from .zenoh_ros import GRAPH_KEY, data_key, origin_of, parse_token

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Mapping

    from dds_trace.tracefile.format.descriptions import Qos

    from .node import NodeOptions, Publisher, RawMessage, Receive, Subscription, TapReceive, TopicPatterns

MULTICAST = "multicast"
KEY_PREFIX = "dds_trace"
"""Start of every key: topic `NAME` of domain 10 has `dds_trace/10/data/NAME`."""
LOOK_S = 2.0
LONGEST_CALL_S = 60
PUBLISHER, SUBSCRIPTION = "publisher", "subscription"
_SHARED_MEMORY: dict[Transport, dict[str, Any]] = {
    Transport.DEFAULT: {},
    # By default messages below 3 KB stay on the link.
    Transport.SHM: {"enabled": True, "transport_optimization": {"enabled": True, "message_size_threshold": 1}},
    Transport.TCP: {"enabled": False},
}
"""`transport/shared_memory` of zenoh's configuration, on by default."""


class ZenohNode(Node):
    def __init__(self, options: NodeOptions) -> None:
        import zenoh

        super().__init__(options)
        _check_qos(options.qos)
        zenoh.init_log_from_env_or("error")
        configuration = zenoh_configuration(options)
        try:
            self._session: Any = zenoh.open(_added_to_own(configuration))
        except zenoh.ZError as err:
            raise OptionError(
                f"zenoh cannot open {configuration['listen']['endpoints']} ({err}); the backend zenoh has one relay "
                "for each domain of a device: end the other one, or choose another --domain"
            ) from err
        self._middleware = Middleware(
            "zenoh",
            "zenoh",
            None,
            {"eclipse-zenoh": metadata.version("eclipse-zenoh")},
            {
                "discovery": options.discovery.value,
                "listen": " ".join(configuration["listen"]["endpoints"]),
                "connect": " ".join(configuration["connect"]["endpoints"]),
                "transport": options.transport.value,
                "multicast": str(configuration["scouting"]["multicast"]["enabled"]).lower(),
                "tuned": "nothing to tune: zenoh's TCP sizes its buffers itself" if options.tuned else "false",
            },
        )
        self._secured_by = ""
        self._subscriptions: list[_ZenohSubscription] = []
        self._own_types: dict[str, set[str]] = {}
        self._started = False

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RawMessage]:
        import zenoh

        qos = qos or self.options.qos
        _check_qos(qos)
        is_reliable = qos.reliability == Reliability.RELIABLE
        congestion, reliability = zenoh.CongestionControl, zenoh.Reliability
        # When full, block as a reliable DDS writer does, or drop as a best-effort one does.
        usual = WhenFull.BLOCK if is_reliable else WhenFull.DROP
        when_full = usual if self.options.when_full is WhenFull.DEFAULT else self.options.when_full
        priority = self.options.priority
        publisher = self._session.declare_publisher(
            self._key("data", topic),
            congestion_control={WhenFull.BLOCK: congestion.BLOCK, WhenFull.DROP: congestion.DROP}[when_full],
            priority=None if priority is None else _priorities()[priority - 1],
            reliability=reliability.RELIABLE if is_reliable else reliability.BEST_EFFORT,
            express=True,  # not batched with the next message
        )
        self.publisher_settings = {
            "priority": str(_priorities().index(publisher.priority) + 1),
            "when_full": "block" if publisher.congestion_control == congestion.BLOCK else "drop",
        }
        return _ZenohPublisher(publisher, publisher.put, self._announce(PUBLISHER, topic, type_name))

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        _check_qos(qos or self.options.qos)
        declare = partial(self._session.declare_subscriber, self._key("data", topic), self._guarded(receive))
        subscription = _ZenohSubscription(declare, self._announce(SUBSCRIPTION, topic, type_name))
        self._subscriptions.append(subscription)
        if self._started:
            subscription.open()
        return subscription

    def _guarded(self, receive: Receive[RawMessage]) -> Callable[[Any], None]:
        # zenoh queues each sample for a Python thread. With its own thread (`indirect=False`) a round trip of 1 MB
        # takes 4.2 ms instead of 1.7.
        def on_sample(sample: Any) -> None:
            if self.error is None:
                try:
                    receive(sample.payload.to_bytes())
                except BaseException as error:  # noqa: BLE001 - a thread has no caller
                    self.error = error

        return on_sample

    def list_publications(self, matches: TopicPatterns) -> list[Publication]:
        keys = self._announced(self._key("endpoint", PUBLISHER, "*", "*", "*"))
        endpoints = list(map(_own_publication, keys))
        types = defaultdict[str, set[str]](set)
        for publication in endpoints:
            types[publication.topic].add(publication.type_name)
        self._own_types = dict(types)
        ros_endpoints = map(parse_token, self._announced(GRAPH_KEY.format(domain_id=self.options.domain_id)))
        return [
            *(
                publication
                for publication in (*endpoints, *ros_endpoints)
                if publication and matches(publication.topic)
            ),
            *(
                Publication(text, "", is_seen=False) for text in matches.texts if not text.startswith("/")
            ),  # keys outside ROS
        ]

    def create_tap(self, topic: str, type_name: str, receive: TapReceive, *, qos: Qos) -> Subscription:  # noqa: ARG002
        def on_sample(sample: Any) -> None:
            if self.error is None:
                try:
                    sequence, source_ns, gid = origin_of(sample, is_ros=is_ros)
                    receive(sample.payload.to_bytes(), source_ns, 0, sequence, gid)
                except BaseException as error:  # noqa: BLE001 - a thread has no caller
                    self.error = error

        def on_own(sample: Any) -> None:  # the key of our own messages has no type
            if type_name in self._own_types.get(f"/{topic.strip('/')}", (type_name,)):
                on_sample(sample)

        is_ros = type_name.count("/") == 2
        receivers = {topic: on_sample}
        if is_ros:
            key = data_key(self.options.domain_id, topic, type_name)
            receivers = {key: on_sample, self._key("data", topic.strip("/")): on_own}
        subscribers = [self._session.declare_subscriber(key, on_sample) for key, on_sample in receivers.items()]

        def close() -> None:
            for subscriber in subscribers:
                subscriber.undeclare()

        return NodeSubscription(close)

    def publisher_of(self, source: Hashable) -> str | None:
        return None if source is None else str(source)

    def members(self, type_name: str) -> Mapping[str, str] | None:
        return DDS_TYPES.get(type_name)

    def _key(self, *parts: str) -> str:
        return "/".join((KEY_PREFIX, str(self.options.domain_id), *parts))

    def _announce(self, kind: str, topic: str, type_name: str) -> Any:
        key = self._key("endpoint", kind, topic, self.options.name, type_name.replace("/", "."))
        return self._session.liveliness().declare_token(key)

    def start(self) -> None:
        self._started = True
        for subscription in self._subscriptions:
            subscription.open()

    def look_at(self, topic: str) -> TopicView:
        return TopicView(topic, tuple(self._endpoints(PUBLISHER, topic)), tuple(self._endpoints(SUBSCRIPTION, topic)))

    def _endpoints(self, kind: str, topic: str) -> list[Endpoint]:
        seen = map(_own_publication, self._announced(self._key("endpoint", kind, topic, "*", "*")))
        return [Endpoint(endpoint.node_name, endpoint.type_name) for endpoint in seen]

    def _announced(self, key: str) -> list[str]:
        replies = self._session.liveliness().get(key, timeout=LOOK_S)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def read_security(self) -> str:
        links = {str(link.dst).partition(":")[0] for link in self._session.info.links()}
        # At the end the other side may have left.
        self._secured_by = ", ".join(sorted(link for link in links if link.startswith("tls/"))) or self._secured_by
        return self._secured_by

    def explain_security(self) -> str:
        if self.options.listens or MULTICAST in self.options.peers:
            return ""
        return unlike_tls(BACKEND.peer_addresses(self.options), is_secured=self.options.keys is not None)

    def count_participants(self) -> int | None:
        return 1 + len(self._session.info.peers_zid()) + len(self._session.info.routers_zid())

    def _stop_receiving(self, timeout_s: float | None) -> None:  # noqa: ARG002 - zenoh's threads end with the session
        for subscription in self._subscriptions:
            subscription.close()

    def _leave(self) -> None:
        self._session.close()


class ZenohCallNode(ZenohNode):
    """A session in which publishers call and subscriptions are queryables; the way back of a topic is their replies."""

    def __init__(self, options: NodeOptions) -> None:
        super().__init__(options)
        self._takers: dict[str, Receive[RawMessage]] = {}  # way back -> takes replies
        self._replies: dict[str, RawMessage] = {}  # way back -> reply, within the callback of a queryable

    def _key(self, *parts: str) -> str:
        return super()._key("call", *parts)

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RawMessage]:
        import zenoh

        _check_qos(qos or self.options.qos)
        token = self._announce(PUBLISHER, topic, type_name)
        if topic.endswith(RELAY_SUFFIX):
            return _ZenohPublisher(None, partial(self._replies.__setitem__, topic), token)
        is_reliable = (qos or self.options.qos).reliability == Reliability.RELIABLE
        querier = self._session.declare_querier(
            self._key("data", topic),
            congestion_control=zenoh.CongestionControl.BLOCK if is_reliable else zenoh.CongestionControl.DROP,
            express=True,
            timeout=LONGEST_CALL_S,
        )
        take = self._guarded(self._takers[topic + RELAY_SUFFIX])

        def on_reply(reply: Any) -> None:
            if reply.ok is not None:
                take(reply.ok)

        return _ZenohCaller(querier, lambda message: querier.get(on_reply, payload=message), token)

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        _check_qos(qos or self.options.qos)
        token = self._announce(SUBSCRIPTION, topic, type_name)
        if topic.endswith(RELAY_SUFFIX):
            self._takers[topic] = receive
            return NodeSubscription(token.undeclare)
        take, key = self._guarded(receive), self._key("data", topic)
        size = requested_bytes(self.options.call, self.options.response_bytes)

        def on_query(query: Any) -> None:
            if query.payload is not None:
                take(query)
            reply = self._replies.pop(topic + RELAY_SUFFIX, None)
            if reply is not None:
                query.reply(
                    key, reply if size is None else bytes(reply[:LEAST_RESPONSE_BYTES]).ljust(size, b"."), express=True
                )
            query.drop()

        subscription = _ZenohSubscription(partial(self._session.declare_queryable, key, on_query), token)
        self._subscriptions.append(subscription)
        if self._started:
            subscription.open()
        return subscription


def _own_publication(key: str) -> Publication:
    topic, node_name, type_name = key.split("/")[-3:]
    return Publication(f"/{topic}", type_name.replace(".", "/"), None, node_name)


@dataclass(frozen=True, slots=True)
class _ZenohPublisher:
    publisher: Any
    publish: Callable[[RawMessage], None]
    token: Any

    def close(self) -> None:
        self.token.undeclare()
        if self.publisher is not None:
            self.publisher.undeclare()


class _ZenohCaller(_ZenohPublisher):
    def is_matched(self) -> bool:
        return bool(self.publisher.matching_status.matching)

    def describe(self) -> dict[str, int]:
        return {}


class _ZenohSubscription:
    def __init__(self, declare: Callable[[], Any], token: Any) -> None:
        self._declare = declare
        self._token = token
        self._subscriber: Any = None
        self._closed = False

    def open(self) -> None:
        if self._subscriber is None and not self._closed:
            self._subscriber = self._declare()

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._token.undeclare()
        if self._subscriber is not None:
            self._subscriber.undeclare()


def zenoh_configuration(options: NodeOptions) -> dict[str, Any]:
    multicast = MULTICAST in options.peers
    shared_memory = _SHARED_MEMORY[options.transport]
    if options.security is not Security.OFF:
        if options.transport is Transport.SHM:
            raise OptionError("-o transport=shm: shared memory is not encrypted; leave it or -o security out")
        shared_memory = {"enabled": False}
    sizes = options.sizes
    if sizes.segment is not None:
        pool = {**shared_memory.get("transport_optimization", {"enabled": True}), "pool_size": sizes.segment}
        shared_memory = {"enabled": True, **shared_memory, "transport_optimization": pool}
    link: dict[str, Any] = {} if options.keys is None else {"tls": zenoh_tls(options.keys, listens=options.listens)}
    if sizes.buffer is not None:
        link["tcp"] = {"so_rcvbuf": sizes.buffer, "so_sndbuf": sizes.buffer}
    if sizes.fragment is not None:
        link["tx"] = {"batch_size": sizes.fragment}
    transport: dict[str, Any] = {"shared_memory": shared_memory} if shared_memory else {}
    if link:
        transport["link"] = link
    scheme = "tcp" if options.keys is None else "tls"
    listen, connect = [], []
    if options.listens:
        host = "127.0.0.1" if options.discovery is Discovery.LOCALHOST else "0.0.0.0"  # noqa: S104 - the range is the subnet
        listen = [f"{scheme}/{host}:{BACKEND.port_of(options.domain_id)}"]
    elif not multicast:
        connect = [f"{scheme}/{host}:{number}" for host, number in BACKEND.peer_addresses(options)]
    elif options.discovery is Discovery.LOCALHOST:
        raise OptionError("--peer multicast looks beyond this device; give --discovery subnet as well")
    return {
        "mode": "peer",
        "listen": {"endpoints": listen},
        "connect": {
            "endpoints": connect,
            "timeout_ms": -1,  # tries for ever: the relay may start later
            "exit_on_failure": False,
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": multicast}, "gossip": {"enabled": False}},
        **({"transport": transport} if transport else {}),
    }


def _added_to_own(configuration: Mapping[str, Any]) -> Any:
    import zenoh

    path = os.environ.get("ZENOH_CONFIG")
    try:
        configured = zenoh.Config.from_file(path) if path else zenoh.Config()
    except zenoh.ZError as err:
        # Its own words quote the file.
        reason = re.search(r"unknown field `\w{1,40}`", str(err))
        line = re.search(r"(?:-->|line:?) (\d+)", str(err))
        where = f" (line {line[1]})" if line else ""
        raise OptionError(
            f"zenoh does not accept {path}: {reason[0] if reason else 'not a configuration in .json, .json5 or .yaml'}{where}; "
            "correct it there"
        ) from None
    for name, value in configuration.items():
        configured.insert_json5(name, json.dumps(_joined(json.loads(configured.get_json(name)), value)))
    return configured


def _joined(old: Any, new: Any) -> Any:
    if not isinstance(new, dict) or not isinstance(old, dict):
        return new
    return {**old, **{name: _joined(old.get(name), value) for name, value in new.items()}}


def _priorities() -> list[Any]:
    import zenoh

    names = ("REAL_TIME", "INTERACTIVE_HIGH", "INTERACTIVE_LOW", "DATA_HIGH", "DATA", "DATA_LOW", "BACKGROUND")
    return [getattr(zenoh.Priority, name) for name in names]


def _check_qos(qos: Qos) -> None:
    refuse_policies("zenoh", qos, "zenoh keeps no messages for late subscriptions without a storage")


BACKEND = Backend(
    name="zenoh",
    label="Zenoh",
    make_node=lambda options: (ZenohNode if options.call is Call.NONE else ZenohCallNode)(options),
    find_installed=lambda: [None] if has_package("zenoh") else [],
    install="pip install 'dds-trace[zenoh]' (in a clone '.[zenoh]')",
    meeting=Meeting.PEERS,
    meeting_needs=(
        "both have --backend zenoh and the same --domain, --peer names the relay's device, and nothing blocks its TCP "
        "port {port}"
    ),
    relay_port=9,
    transports=tuple(_SHARED_MEMORY),
    security=(Security.ENCRYPT_RTPS,),
    priorities=range(1, 8),
    sizes={
        Transport.DEFAULT: ("buffer", "segment", "fragment"),
        Transport.SHM: ("segment",),
        Transport.TCP: ("buffer", "fragment"),
    },
    can_drop=True,
    calls=(Call.SERVICE,),
    variables_of=lambda _, path: {"ZENOH_CONFIG": str(path)},
    environment=MiddlewareEnvironment(
        configuration=(
            ConfigurationVariable("ZENOH_CONFIG"),
            ConfigurationVariable("ZENOH_SESSION_CONFIG_URI"),
            ConfigurationVariable("ZENOH_ROUTER_CONFIG_URI"),
            ConfigurationVariable("ZENOH_CONFIG_OVERRIDE"),
        )
    ),
)
