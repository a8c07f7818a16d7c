"""The two forms in which messages pass a node: serialized bytes, or message objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any, Generic, TypeVar

from dds_trace.base.errors import OptionError
from dds_trace.tracefile.format.descriptions import Qos

from ..backends.node import (
    Caller,
    CallMessage,
    CallNode,
    Node,
    ObjectNode,
    Publisher,
    RawMessage,
    Receive,
    RosMessage,
    Subscription,
)
from ..choices import Serialization
from ..payloads.base import DataType, Form, Message
from ..payloads.stamp import CALL_STAMP, SentT

ReceivedT = TypeVar("ReceivedT")


@dataclass(frozen=True, slots=True)
class Lane(Generic[SentT, ReceivedT]):
    """One form of messages on a node; `form_of` refuses data types without it."""

    form_of: Callable[[DataType], Form[SentT, ReceivedT]]
    message_of: Callable[[DataType, Message], SentT]
    create_publisher: Callable[[str, str, Qos], Publisher[SentT]]
    create_subscription: Callable[[str, str, Receive[ReceivedT], Qos], Subscription]


def open_lane(node: Node, serialization: Serialization) -> Lane[Any, Any]:
    if isinstance(node, CallNode):
        return call_lane(node)
    return object_lane(node) if serialization is Serialization.TYPED else raw_lane(node)


def raw_lane(node: Node) -> Lane[bytearray, RawMessage]:
    return Lane(
        lambda data_type: data_type.raw,
        lambda _data_type, message: message.data,
        lambda topic, name, qos: node.create_publisher(topic, name, qos=qos),
        lambda topic, name, receive, qos: node.create_subscription(topic, name, receive, qos=qos),
    )


def object_lane(node: Node) -> Lane[RosMessage, RosMessage]:
    objects = message_objects_of(node)
    return Lane(
        lambda data_type: data_type.object_form(),
        lambda data_type, message: objects.message_from_cdr(data_type.type_name, message.data),
        lambda topic, name, qos: objects.create_object_publisher(topic, name, qos=qos),
        lambda topic, name, receive, qos: objects.create_object_subscription(topic, name, receive, qos=qos),
    )


def message_objects_of(node: Node) -> ObjectNode:
    if not isinstance(node, ObjectNode):
        raise OptionError(
            f"-o serialization=typed: the backend {node.middleware.backend} only carries serialized messages"
        )
    return node


def _call_bytes(call: CallMessage) -> int:
    return call.payload_bytes


def call_lane(calls: CallNode) -> Lane[CallMessage, CallMessage]:
    form = Form(CALL_STAMP, _call_bytes, whole_bytes_of=_call_bytes)
    return Lane(
        lambda _data_type: form,
        lambda _data_type, message: CallMessage("", message.data, message.payload_bytes),
        lambda topic, _name, qos: calls.create_caller(topic, qos),
        lambda topic, _name, receive, qos: calls.create_server(topic, receive, qos),
    )


class Clients(Generic[SentT]):
    def __init__(self, publishers: Sequence[Publisher[SentT]]) -> None:
        turns = cycle(publishers)
        self.publish = (
            publishers[0].publish if len(publishers) == 1 else lambda message, /: next(turns).publish(message)
        )
        self.callers = [publisher for publisher in publishers if isinstance(publisher, Caller)]
        self._publishers = publishers

    def close(self) -> None:
        for publisher in self._publishers:
            publisher.close()
