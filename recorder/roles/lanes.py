"""The two lanes on which messages pass a node: `RawLane` as serialized bytes, `ObjectLane` as message objects."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar

from ..backends.node import message_objects_of
from ..payloads.stamp import SentT

if TYPE_CHECKING:
    from dds_trace.tracefile.format.descriptions import Qos

    from ..backends.node import Node, Publisher, RawMessage, Receive, RosMessage, Subscription
    from ..payloads.base import DataType, Form, Message

ReceivedT = TypeVar("ReceivedT")


class Lane(Protocol[SentT, ReceivedT]):
    """One way for messages through a node: how they look, and the endpoints that take them."""

    def form_of(self, data_type: DataType) -> Form[SentT, ReceivedT]:
        """Return the form of a data type's messages on this lane.

        Raises:
            OptionError: the type does not travel in this form.
        """

    def message_of(self, data_type: DataType, message: Message) -> SentT:
        """Return a message of the payload in the form in which it is sent."""

    def create_publisher(self, topic: str, type_name: str, qos: Qos) -> Publisher[SentT]:
        """Create the sending end; errors as for `Node.create_publisher`."""

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[ReceivedT], qos: Qos
    ) -> Subscription:
        """Create the receiving end; errors as for `Node.create_subscription`."""


class RawLane:
    """The lane of serialized messages, which every node has."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def form_of(self, data_type: DataType) -> Form[bytearray, RawMessage]:
        """Return the form of serialized messages."""
        return data_type.raw

    def message_of(self, _data_type: DataType, message: Message) -> bytearray:
        """Return the buffer of `message` itself, in which the stamp is patched."""
        return message.data

    def create_publisher(self, topic: str, type_name: str, qos: Qos) -> Publisher[bytearray]:
        """Create a publisher of serialized messages."""
        return self._node.create_publisher(topic, type_name, qos=qos)

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], qos: Qos
    ) -> Subscription:
        """Create a subscription of serialized messages."""
        return self._node.create_subscription(topic, type_name, receive, qos=qos)


class ObjectLane:
    """The lane of message objects.

    Raises:
        OptionError: the node's backend only carries serialized messages.
    """

    def __init__(self, node: Node) -> None:
        self._node = message_objects_of(node)

    def form_of(self, data_type: DataType) -> Form[RosMessage, RosMessage]:
        """Return the form of message objects."""
        return data_type.object_form()

    def message_of(self, data_type: DataType, message: Message) -> RosMessage:
        """Return `message` as an object."""
        return self._node.message_from_cdr(data_type.type_name, message.data)

    def create_publisher(self, topic: str, type_name: str, qos: Qos) -> Publisher[RosMessage]:
        """Create a publisher of message objects."""
        return self._node.create_object_publisher(topic, type_name, qos=qos)

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RosMessage], qos: Qos
    ) -> Subscription:
        """Create a subscription of message objects."""
        return self._node.create_object_subscription(topic, type_name, receive, qos=qos)
