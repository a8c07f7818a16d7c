"""`Node`, a participant as the roles use it, its publishers and subscriptions."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar, runtime_checkable

from dds_trace.base import limits
from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Qos

from ..choices import Call, Discovery, ExecutorKind, Security, Transport, WhenFull
from ..option import OUTSIDE_OF_KEY, Axis, detail, option
from .other_side import Strangers, unlike_participant
from .sizes import Sizes, call_option, response_size_option, size_option

if TYPE_CHECKING:
    from typing_extensions import Self

ROUND_S = 0.1
STOP_S = 5.0  # for a node's thread to end, before the trace is closed without it
LAST_ACKNOWLEDGEMENT_S = 0.5
"""Longest wait of a closing publisher: a participant that leaves at once takes its last messages with it."""

RawMessage: TypeAlias = "bytes | bytearray"
"""A whole serialized message: 4 bytes of encapsulation, then CDR. A callback may change a received `bytearray`."""

RosMessage: TypeAlias = Any  # of a class that ROS 2 generates

RELAY_SUFFIX = "_relay"  # of the topic of a way back

MessageT_contra = TypeVar("MessageT_contra", contravariant=True)


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """How to open a node.

    Attributes:
        qos: of every data topic, unless an endpoint has its own.
        listens: whether the node waits for others to connect (a relay), where a backend has such sides.
    """

    domain_id: int = detail(
        10,
        "--domain ID",
        "DDS domain. Default: ROS_DOMAIN_ID, else 10, of a tap and beacon 0; a ping with --bridge: 5",
        limit=limits.DOMAIN_ID,
        variables=("ROS_DOMAIN_ID",),
    )
    name: str = field(default="dds_trace", metadata=OUTSIDE_OF_KEY)
    discovery: Discovery = option(
        Discovery.SUBNET,
        "--discovery RANGE",
        "How far to look for other nodes: localhost or subnet. Default: as ROS 2's environment variables have it, else subnet (socket and zenoh without --peer: localhost)",
        variables=("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"),
    )
    peers: tuple[str, ...] = detail(
        (),
        "--peer HOST",
        "Address of the relay's device, HOST or HOST:PORT, for a backend that does not discover it; repeatable.",
        limit=limits.HOST,
    )
    rmw: str | None = detail(
        None,
        "--rmw RMW",
        "ROS middleware of the backend ros2. Default: RMW_IMPLEMENTATION, else the default of ROS 2",
        limit=limits.RMW,
        axis=Axis(),
        variables=("RMW_IMPLEMENTATION",),
    )
    qos: Qos = field(default_factory=Qos)
    transport: Transport = option(
        Transport.DEFAULT,
        "--transport KIND",
        "Fast DDS: default, udp, shm or large-data; zenoh: default, shm or tcp; socket: default (TCP) or udp.",
        axis=Axis(meaning="transports that Fast DDS, zenoh or `socket` may use ([middlewares](middlewares.md))"),
    )
    configuration: Path | None = detail(
        None,
        "--configuration FILE",
        "The middleware's own settings: XML of Fast DDS or Cyclone DDS, JSON5 of zenoh. Default: the file in its own variable",
        parse=Path,
        axis=Axis(
            meaning="file with the middleware's own settings: XML of Fast DDS or Cyclone DDS, JSON5 of zenoh; results are named after it"
        ),
    )
    executor: ExecutorKind = option(
        ExecutorKind.AUTO,
        "--executor KIND",
        "Executor of rclpy: events, single, or auto, the fastest one installed.",
        axis=Axis(),
    )
    tuned: bool = option(
        False,
        "--tuned",
        "Apply the vendor's settings for large messages.",
        limit=limits.FLAG,
        axis=Axis(meaning="whether the vendor's settings for large messages are applied"),
    )
    congestion_control: str | None = option(
        None,
        "--congestion-control NAME",
        "Congestion control of TCP, for the backend socket: cubic, bbr, reno ... Default: the system's",
        axis=Axis(),
    )
    security: Security = option(
        Security.OFF,
        "--security LEVEL",
        "DDS Security of Cyclone DDS and ROS 2 where they have its plugins, TLS (encrypt-rtps) of sockets, zenoh, and the link of a "
        "zenoh bridge:",
        axis=Axis(
            meaning="what is protected, by DDS Security or TLS with keys made for the sweep ([security](../how-to/axes.md#security))"
        ),
    )
    keys: str | None = detail(
        None,
        "--keys FOLDER",
        "Keys for security, the same folder on both sides; a new one is removed at the end.",
        limit=limits.TEXT,
    )
    priority: int | None = option(
        None,
        "--priority N",
        "Priority of the messages: for zenoh 1 (first) to 7, for Cyclone DDS the transport priority. Default: the vendor's",
        limit=limits.PRIORITY,
        axis=Axis(),
    )
    when_full: WhenFull = option(
        WhenFull.DEFAULT,
        "--when-full KIND",
        "For zenoh, when the link is full: default (block if reliable, else drop), block or drop.",
        axis=Axis(),
    )
    multicast: bool = option(
        True,
        "--no-multicast",
        "Cyclone DDS: send each message to each relay by itself; multicast is left to discovery.",
    )
    buffer_bytes: int | None = size_option("buffer", "Receive buffer of each socket", limits.BUFFER_BYTES)
    segment_bytes: int | None = size_option("segment", "Shared memory for messages", limits.SEGMENT_BYTES)
    fragment_bytes: int | None = size_option("fragment", "Largest part of a message in a packet", limits.FRAGMENT_BYTES)
    call: Call = call_option()  # noqa: RUF009 - a field, as the others
    response_bytes: int | None = response_size_option(limits.RESPONSE_BYTES)
    listens: bool = field(default=False, metadata=OUTSIDE_OF_KEY)

    @property
    def sizes(self) -> Sizes:
        return Sizes(self.buffer_bytes, self.segment_bytes, self.fragment_bytes)


@dataclass(frozen=True, slots=True)
class Middleware:
    """The software that carries the messages, as it reports itself."""

    backend: str
    vendor: str
    rmw: str | None  # None outside ROS
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)
    vendor_label: str = ""  # for people; empty: the backend's


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One publisher or subscription on a topic; its node's name may be empty and its QoS None, if unknown."""

    node_name: str
    type_name: str
    qos: Qos | None = None


@dataclass(frozen=True, slots=True)
class TopicView:
    """The endpoints that a node sees on one topic; `incompatible` has a line for each pair that can never match.

    `unassignable` has one for each endpoint with a message type of our name but another definition.
    """

    topic: str
    publishers: tuple[Endpoint, ...] = ()
    subscriptions: tuple[Endpoint, ...] = ()
    incompatible: tuple[str, ...] = ()
    unassignable: tuple[str, ...] = ()


class Receive(Protocol[MessageT_contra]):
    """A callback on the node's thread, which stamps T2 or T3 first; the middleware's stamps (ns since 1970) may be 0."""

    def __call__(self, message: MessageT_contra, source_ns: int = 0, received_ns: int = 0, /) -> None:
        """Take one message."""


class Publisher(Protocol[MessageT_contra]):
    """The sending end of a topic."""

    def publish(self, message: MessageT_contra, /) -> None:
        """Hand over a message, from one thread at a time; the buffer may change afterwards."""

    def close(self) -> None: ...  # takes the publisher off its topic


class Subscription(Protocol):
    """The receiving end of a topic."""

    def close(self) -> None: ...  # at the end of the thread's current round


@dataclass(frozen=True, slots=True)
class Publication:
    """One publisher as the graph shows it.

    Attributes:
        topic: name with its first slash.
        publisher: GUID in 32 hex digits; None if the middleware does not give it.
        node_name: with namespace; empty if unknown.
        is_local: whether it runs on this device.
        is_seen: False for a name that was asked for and that may have no publisher.
    """

    topic: str
    type_name: str
    publisher: str | None = None
    node_name: str = ""
    qos: Qos | None = None
    is_local: bool | None = None
    is_seen: bool = True


@dataclass(frozen=True, slots=True)
class TopicPatterns:
    """Names of topics with `*` and `?`; a name without a first slash is one outside ROS."""

    texts: tuple[str, ...]

    def __call__(self, topic: str) -> bool:
        return any(fnmatchcase(topic, text) for text in self.texts)


class TapReceive(Protocol):
    """A callback of a tap, on the node's thread; it stamps the arrival in its first instruction."""

    def __call__(
        self, message: RawMessage, source_ns: int, received_ns: int, sequence: int, source: Hashable, /
    ) -> None:
        """Take one message.

        `sequence` is the publisher's number of the message, from 1; 0 if unknown. `source` is the publisher, as the node identifies
        it (`TapNode.publisher_of`); None if the middleware does not say who sent it.
        """


@runtime_checkable
class TapNode(Protocol):
    """A node that can listen to other programs."""

    def list_publications(self, matches: TopicPatterns) -> list[Publication]:
        """Return the publishers of other nodes."""

    def create_tap(self, topic: str, type_name: str, receive: TapReceive, *, qos: Qos) -> Subscription:
        """Subscribe to serialized messages of any type; a `BackendUnavailableError` names a package of messages that is needed."""

    def publisher_of(self, source: Hashable) -> str | None:
        """Return the `Publication.publisher` of a message's `source`."""

    def members(self, type_name: str) -> Mapping[str, str] | None:
        """Return members and their types; None if the node does not know the message type."""


class Node(ABC):
    """One participant in one domain: create the endpoints, `start`, then `close`.

    Attributes:
        error: the exception that ended a thread of the node.
        strangers: what peers sent and the node or its role did not accept.
        publisher_settings: `priority` and `when_full` as its latest publisher reports them, where they were requested.
    """

    _middleware: Middleware  # from the moment it runs

    def __init__(self, options: NodeOptions) -> None:
        self.options = options
        self._closing = self._has_left = False
        self.error: BaseException | None = None
        self.strangers = Strangers()
        self.publisher_settings: dict[str, str] = {}

    @property
    def middleware(self) -> Middleware:
        return self._middleware

    @abstractmethod
    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RawMessage]:
        """Create a publisher on a ROS name without the first slash; an `OptionError` for a quality of service or type that it lacks."""

    @abstractmethod
    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        """Create a subscription that calls `receive` for each message; see `create_publisher`."""

    @abstractmethod
    def start(self) -> None:
        """Start to call the subscriptions."""

    @abstractmethod
    def look_at(self, topic: str) -> TopicView:
        """Return the endpoints that the node sees now, its own included."""

    def read_security(self) -> str:
        """Return in words what secures the messages, as the middleware or a connection reports it."""
        return ""

    def explain_security(self) -> str:
        """Return in words that the other side is secured and this one is not, or the other way round; slow."""
        network = self.middleware.backend, str(self.options.domain_id), self.options.discovery.value
        return unlike_participant(self.participant_names(), self.options.security, network)

    def participant_names(self) -> list[str]:
        """Return the names of the participants (ROS: nodes) seen so far, the own one included."""
        return []

    def count_participants(self) -> int | None:
        """Count the participants (ROS: nodes) of the domain; None if the backend cannot."""
        return len(self.participant_names()) or None

    def describe_others(self) -> str:
        """Return in words how many other participants the node sees."""
        count = self.count_participants()
        return "an unknown number of other nodes" if count is None else counted(count - 1, "other node")

    def stop_receiving(self, timeout_s: float | None = STOP_S) -> None:
        """Call the subscriptions no more; interrupt what blocks in sending, where the middleware can."""
        self._closing = True
        self._stop_receiving(timeout_s)

    def close(self) -> None:
        """Stop receiving, send what is queued, leave the domain; a second call does nothing."""
        if not self._has_left:
            self._has_left = True
            self.stop_receiving(None)
            self._leave()

    @abstractmethod
    def _stop_receiving(self, timeout_s: float | None) -> None: ...

    @abstractmethod
    def _leave(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


class ThreadedNode(Node):
    """A node with one thread of ours for its subscriptions."""

    def __init__(self, options: NodeOptions) -> None:
        super().__init__(options)
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        name = f"{self.middleware.backend}-domain-{self.options.domain_id}"
        self._thread = threading.Thread(target=self._receive_until_closed, name=name, daemon=True)
        self._thread.start()

    def _receive_until_closed(self) -> None:
        try:
            receive_round = self._make_round()
            while not self._closing:
                receive_round()
        except BaseException as error:  # noqa: BLE001 - a thread has no caller
            self.error = error

    @abstractmethod
    def _make_round(self) -> Callable[[], None]:
        """Return the body of the thread's loop, which waits at most `ROUND_S` and delivers what has arrived."""

    def _wake(self) -> None:
        """Cut the thread's current wait short, where the middleware can."""

    def _stop_receiving(self, timeout_s: float | None) -> None:
        self._wake()
        if self._thread is not None:
            self._thread.join(timeout_s)


@dataclass(frozen=True, slots=True)
class NodeSubscription:
    """A subscription that its node closes; a second call of `close` does nothing."""

    close: Callable[[], None]


@runtime_checkable
class ObjectNode(Protocol):
    """A node of a client library with message objects (ROS 2)."""

    def create_object_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RosMessage]:
        """See `Node.create_publisher`."""

    def create_object_subscription(
        self, topic: str, type_name: str, receive: Receive[RosMessage], *, qos: Qos | None = None
    ) -> Subscription:
        """See `Node.create_subscription`."""

    def message_from_cdr(self, type_name: str, data: RawMessage) -> RosMessage:
        """Deserialize a message."""

    def message_to_cdr(self, message: RosMessage) -> bytes:
        """Serialize a message object."""


@dataclass(slots=True)
class CallMessage:
    """A request or response of a typed call; `data` is what a request carries, serialized, and empty in what is received."""

    stamp: str
    data: RawMessage = b""
    payload_bytes: int = 0
    built: Any = None


@runtime_checkable
class CallNode(Protocol):
    """A node with calls of typed messages as topics: a publisher calls, a subscription serves, and a relay's publisher responds."""

    def create_caller(self, topic: str, qos: Qos) -> Publisher[CallMessage]:
        """Create a client, or the responding end of a relay."""

    def create_server(self, topic: str, receive: Receive[CallMessage], qos: Qos) -> Subscription:
        """Serve requests, or take the responses of the clients."""


@runtime_checkable
class Caller(Protocol):
    """A publisher that calls."""

    def is_matched(self) -> bool: ...

    def describe(self) -> dict[str, int]:
        """Return times of its calls in ns, at the end of a run."""
