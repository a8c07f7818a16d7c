"""The two forms in which messages pass a node: serialized bytes, or message objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from dds_trace.base.errors import OptionError

from ..backends.node import ObjectNode
from ..payloads.stamp import SentT

if TYPE_CHECKING:
    from collections.abc import Callable

    from dds_trace.tracefile.format.descriptions import Qos

    from ..backends.node import Node, Publisher, RawMessage, Receive, RosMessage, Subscription
    from ..payloads.base import DataType, Form, Message

ReceivedT = TypeVar("ReceivedT")


@dataclass(frozen=True, slots=True)
class Lane(Generic[SentT, ReceivedT]):
    """One form of messages on a node; `form_of` refuses data types without it."""

    form_of: Callable[[DataType], Form[SentT, ReceivedT]]
    message_of: Callable[[DataType, Message], SentT]
    create_publisher: Callable[[str, str, Qos], Publisher[SentT]]
    create_subscription: Callable[[str, str, Receive[ReceivedT], Qos], Subscription]


def raw_lane(node: Node) -> Lane[bytearray, RawMessage]:
    """Return the lane of serialized messages; stamps are patched in the payload's buffers."""
    return Lane(
        lambda data_type: data_type.raw,
        lambda _data_type, message: message.data,
        lambda topic, name, qos: node.create_publisher(topic, name, qos=qos),
        lambda topic, name, receive, qos: node.create_subscription(topic, name, receive, qos=qos),
    )


def object_lane(node: Node) -> Lane[RosMessage, RosMessage]:
    """Return the lane of message objects; raise an OptionError if the backend has none."""
    objects = message_objects_of(node)
    return Lane(
        lambda data_type: data_type.object_form(),
        lambda data_type, message: objects.message_from_cdr(data_type.type_name, message.data),
        lambda topic, name, qos: objects.create_object_publisher(topic, name, qos=qos),
        lambda topic, name, receive, qos: objects.create_object_subscription(topic, name, receive, qos=qos),
    )


def message_objects_of(node: Node) -> ObjectNode:
    """Return `node` as one with message objects; raise an `OptionError` if it has none."""
    if not isinstance(node, ObjectNode):
        raise OptionError(
            f"--serialization typed: the backend {node.middleware.backend} only carries serialized messages"
        )
    return node
