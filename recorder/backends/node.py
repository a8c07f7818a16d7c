"""A participant as the roles use it: a `Node` with publishers and subscriptions, whatever middleware carries them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar, runtime_checkable

from dds_trace.base.errors import OptionError
from dds_trace.tracefile.format.descriptions import Qos

from ..choices import Discovery, ExecutorKind, Transport

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

RawMessage: TypeAlias = "bytes | bytearray"
"""A whole serialized message: 4 bytes of encapsulation, then CDR. A received `bytearray` is the callback's to change."""

RosMessage: TypeAlias = Any
"""An object of a class that ROS 2 generates from a `.msg` file; such classes have no types."""

MessageT_contra = TypeVar("MessageT_contra", contravariant=True)


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """Everything that a backend needs to know to open a node.

    Attributes:
        domain_id: DDS domain, 0..231; backends without domains keep topics of two domains apart by it.
        name: name of the node in the graph.
        discovery: reach of the node's search for others.
        qos: quality of service of every data topic, unless an endpoint is given its own.
        executor: executor that calls the subscriptions (`ros2` alone has a choice).
        rmw: ROS middleware to run on, None for that of the environment (`ros2` alone has a choice).
        transport: transports that the middleware may use.
        tuned: whether the vendor's documented settings for large messages are applied.
        congestion_control: algorithm of TCP, None for the system's (`socket` alone has a choice).
        listens: whether the node waits for others to connect (a relay), where a backend has such sides.
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
    congestion_control: str | None = None
    listens: bool = False
    peers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Middleware:
    """The software that carries the messages, as the running middleware itself reports it.

    Attributes:
        backend: name of the API in use, a key of `BACKEND_MODULES`.
        vendor: `fastdds`, `cyclonedds`, `connext`, `zenoh`, `socket`, or what the backend reports.
        rmw: identifier of the running ROS middleware, None outside ROS.
        versions: version of each library involved, by name.
        settings: settings in effect (executor, transport, tuned, environment), by name.
        vendor_label: name of the vendor for people, empty where the backend's label is it.
    """

    backend: str
    vendor: str
    rmw: str | None
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)
    vendor_label: str = ""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One publisher or subscription that a node sees on a topic, its own included.

    Attributes:
        node_name: name of the endpoint's node, empty if unknown.
        type_name: message type, for example `sensor_msgs/msg/Image`.
        qos: quality of service offered or requested, None if the middleware does not report it.
    """

    node_name: str
    type_name: str
    qos: Qos | None = None


@dataclass(frozen=True, slots=True)
class TopicView:
    """The endpoints that a node sees on one topic at one moment.

    Attributes:
        incompatible: one line for each pair that can never match, naming the policy and both sides.
        unassignable: one line for each side whose message type has this node's name and another definition, where the
            middleware tells.
    """

    topic: str
    publishers: tuple[Endpoint, ...] = ()
    subscriptions: tuple[Endpoint, ...] = ()
    incompatible: tuple[str, ...] = ()
    unassignable: tuple[str, ...] = ()


class Receive(Protocol[MessageT_contra]):
    """A callback of a subscription; it runs on the node's own thread and stamps T2 or T3 in its first instruction.

    The two middleware time stamps (ns since 1970) are 0 where the middleware does not report them.
    """

    def __call__(self, message: MessageT_contra, source_ns: int = 0, received_ns: int = 0, /) -> None:
        """Take one message."""


class Publisher(Protocol[MessageT_contra]):
    """The sending end of a topic."""

    def publish(self, message: MessageT_contra, /) -> None:
        """Hand `message` to the middleware.

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
        """Options that the node was opened with."""

    @property
    def middleware(self) -> Middleware:
        """The software that carries the messages."""

    @property
    def error(self) -> BaseException | None:
        """The exception that ended the thread, None while it runs."""

    def create_publisher(
        self, topic: str, type_name: str, *, qos: Qos | None = None
    ) -> Publisher[RawMessage]:
        """Create a publisher of serialized messages.

        Args:
            topic: ROS name without the first slash.
            type_name: message type, such as `sensor_msgs/msg/Image`.
            qos: quality of service, by default that of the node's options.

        Raises:
            OptionError: the backend has no such quality of service or does not know the type.
        """

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        """Create a subscription that calls `receive` for each message once the node is started.

        Arguments and errors as for `create_publisher`.
        """

    def start(self) -> None:
        """Start the thread that calls the subscriptions. An exception of theirs is kept as `error`."""

    def look_at(self, topic: str) -> TopicView:
        """Return the endpoints on `topic` that the node sees now, its own included."""

    def count_participants(self) -> int | None:
        """Count the participants (ROS: nodes) of the domain, this one included; None if the backend cannot."""

    def close(self) -> None:
        """Stop the thread, send what is still held, leave the domain. Closing twice is allowed."""

    def __enter__(self) -> Node:  # noqa: PYI034 - `Self` is Python 3.11's; a Node is all that callers need
        """Return the node itself."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the node."""


@runtime_checkable
class ObjectNode(Protocol):
    """The further abilities of a node whose client library has message objects: that of ROS 2."""

    def create_object_publisher(
        self, topic: str, type_name: str, *, qos: Qos | None = None
    ) -> Publisher[RosMessage]:
        """Create a publisher of message objects; arguments as for `Node.create_publisher`."""

    def create_object_subscription(
        self, topic: str, type_name: str, receive: Receive[RosMessage], *, qos: Qos | None = None
    ) -> Subscription:
        """Create a subscription of message objects; arguments as for `Node.create_subscription`."""

    def message_from_cdr(self, type_name: str, data: RawMessage) -> RosMessage:
        """Make a message object from a serialized message."""

    def message_to_cdr(self, message: RosMessage) -> bytes:
        """Serialize a message object."""


def message_objects_of(node: Node) -> ObjectNode:
    """Return `node` as one that has message objects.

    Raises:
        OptionError: its backend carries serialized messages alone.
    """
    if not isinstance(node, ObjectNode):
        raise OptionError(
            f"--serialization typed: the backend {node.middleware.backend} carries serialized messages alone"
        )
    return node
