"""What every middleware offers a role: `Backend` opens a `Node`; publishers and subscriptions carry raw CDR.

Same names in the same order in every file of `recorder/backends/`. Nothing here imports a middleware.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from dds_trace.tracefile import Qos

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType


class Discovery(Enum):
    """How far a node looks for others."""

    LOCALHOST = "localhost"
    SUBNET = "subnet"


class Serialization(Enum):
    """Whether messages pass the client library as serialized bytes or as message objects."""

    RAW = "raw"
    TYPED = "typed"


class ExecutorKind(Enum):
    """Which executor of the client library calls the subscriptions; `AUTO` is the best that is there."""

    AUTO = "auto"
    EVENTS = "events"
    SINGLE = "single"


class Transport(Enum):
    """Which transports Fast DDS may use; other vendors know `DEFAULT` alone."""

    DEFAULT = "default"
    UDP = "udp"
    SHM = "shm"
    LARGE_DATA = "large-data"


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """All that a backend needs to know to open a node.

    Attributes:
        domain_id: the DDS domain, 0..231; backends without domains keep topics of two domains apart by it.
        name: of the node in the graph.
        discovery: how far the node looks for others.
        qos: of every data topic, unless an endpoint is given its own.
        executor: which executor calls the subscriptions (`ros2` alone has a choice).
        rmw: the ROS middleware to run on, None for what the environment says (`ros2` alone has a choice).
        transport: which transports Fast DDS may use.
        tuned: apply the documented settings for large messages to the vendor.
        listens: this node waits for others to connect (a relay), where a backend has such sides.
        peers: addresses of other nodes, where a backend does not discover them by itself.
    """

    domain_id: int = 10
    name: str = "dds_trace"
    discovery: Discovery = Discovery.SUBNET
    qos: Qos = field(default_factory=Qos)
    executor: ExecutorKind = ExecutorKind.AUTO
    rmw: str | None = None
    transport: Transport = Transport.DEFAULT
    tuned: bool = False
    listens: bool = False
    peers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Middleware:
    """What carries the messages, as the running middleware itself reports it.

    Attributes:
        backend: the API used: `ros2`, `cyclonedds`, `connext`, `zenoh`, `socket`.
        vendor: `fastdds`, `cyclonedds`, `connext`, `zenoh`, `socket`, or what the backend reports.
        rmw: identifier of the running ROS middleware, None outside ROS.
        versions: version of each library involved, by name.
        settings: what was really applied (executor, transport, tuned, environment), by name.
    """

    backend: str
    vendor: str
    rmw: str | None
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One publisher or subscription that a node sees on a topic, its own included.

    Attributes:
        node_name: of the node it belongs to, empty if unknown.
        type_name: for example `sensor_msgs/msg/Image`.
        qos: as offered or requested, None if the middleware does not tell.
    """

    node_name: str
    type_name: str
    qos: Qos | None = None


@dataclass(frozen=True, slots=True)
class TopicView:
    """What a node sees on one topic at the moment.

    Attributes:
        incompatible: one line for each pair that will never match, naming the policy and both sides.
    """

    topic: str
    publishers: tuple[Endpoint, ...] = ()
    subscriptions: tuple[Endpoint, ...] = ()
    incompatible: tuple[str, ...] = ()


RawMessage: TypeAlias = "bytes | bytearray"
"""A whole serialized message: 4 bytes of encapsulation, then CDR."""


class Receive(Protocol):
    """Called once for each received message, on the node's own thread; T2 and T3 are its first instruction.

    The two middleware time stamps (ns since 1970) are 0 where the executor does not give them.
    """

    def __call__(self, message: Any, source_ns: int = 0, received_ns: int = 0, /) -> None:
        """Take `message`: `bytes` of CDR, or a message object from a typed subscription."""


class Publisher(Protocol):
    """The sending end of a topic."""

    def publish(self, message: Any, /) -> None:
        """Hand `message` to the middleware: a `RawMessage`, or a message object if opened as typed.

        The buffer may be changed again as soon as this returns. Any thread may call it, one at a time.
        """

    def close(self) -> None:
        """Take the publisher off the topic."""


class Subscription(Protocol):
    """The receiving end of a topic."""

    def close(self) -> None:
        """Take the subscription off the topic; its callback is not called after the thread's current round."""


class Node(Protocol):
    """One participant in one domain, with a thread of its own that calls its subscriptions.

    Nodes of different domains live side by side in one process. Create the endpoints, then `start`.
    """

    @property
    def options(self) -> NodeOptions:
        """What the node was opened with."""

    @property
    def middleware(self) -> Middleware:
        """What carries the messages, from the running middleware."""

    def create_publisher(
        self, topic: str, type_name: str, *, qos: Qos | None = None, typed: bool = False
    ) -> Publisher:
        """A publisher on `topic` (ROS name without slash) of `type_name` (`sensor_msgs/msg/Image`).

        Raises:
            OptionError: typed messages are asked of a backend that has none.
        """

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive, *, qos: Qos | None = None, typed: bool = False
    ) -> Subscription:
        """A subscription that calls `receive` for each message once the node is started; errors as above."""

    def message_from_cdr(self, type_name: str, data: RawMessage) -> Any:
        """The message object that a typed publisher takes, made from serialized bytes; errors as above."""

    def start(self) -> None:
        """Start the thread that calls the subscriptions. An exception of theirs is kept for `error`."""

    @property
    def error(self) -> BaseException | None:
        """What ended the thread, if something did."""

    def look_at(self, topic: str) -> TopicView:
        """What the node sees on `topic` at the moment, its own endpoints included."""

    def count_participants(self) -> int | None:
        """Participants (ROS: nodes) seen in the domain, this one included; None if the backend cannot tell."""

    def close(self) -> None:
        """Stop the thread, send what is still held, leave the domain. Closing twice is allowed."""

    def __enter__(self) -> Node:  # noqa: PYI034 - `Self` is Python 3.11's; a Node is all that callers need
        """The node itself."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""


class Backend(Protocol):
    """One API that carries messages; each file of `recorder/backends/` has one, named `BACKEND`."""

    @property
    def name(self) -> str:
        """As given to `--backend` and written to the session: `ros2`, `cyclonedds` ..."""

    def open_node(self, options: NodeOptions) -> Node:
        """A node that has joined the domain and is not started yet.

        Raises:
            BackendUnavailableError: the middleware or its licence is not on this machine, and how to get it.
            OptionError: the options cannot be meant (domain id, transport of another vendor).
        """
