"""Calls of ROS 2, a service or an action for each data topic (docs/how-to/axes.md): rclpy has no serialized ones."""

from __future__ import annotations

import statistics
import threading
import time
from array import array
from collections import defaultdict
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ...choices import Call, ExecutorKind
from ..node import RELAY_SUFFIX, CallMessage, Endpoint, NodeSubscription, TopicView
from ..sizes import requested_bytes, text_bytes
from .fastdds_profile import uses_tcp
from .installation import message_class
from .node import Ros2Node, qos_profile

if TYPE_CHECKING:
    from collections.abc import Callable

    from dds_trace.tracefile.format.descriptions import Qos

    from ..node import NodeOptions, Publisher, Receive, RosMessage, Subscription

SERVICE, ACTION = "rcl_interfaces/srv/SetParameters", "test_msgs/action/Fibonacci"
INTEGER_ARRAY = 7
"""`PARAMETER_INTEGER_ARRAY` of `rcl_interfaces/msg/ParameterType`."""
RESULT_KEPT_S = 10
CONVERSIONS = 5
_UINT32 = 0xFFFFFFFF
_PROBE = "dt1:" + 16 * "0"


class Ros2CallNode(Ros2Node):
    _response: _Response
    """Of the latest way back; its server is created next."""
    _take_response: Receive[CallMessage]

    def __init__(self, options: NodeOptions, *more: Any, **keywords: Any) -> None:
        serves_over_tcp = uses_tcp(options) and options.listens and options.call is Call.SERVICE
        if (
            serves_over_tcp and options.executor is ExecutorKind.AUTO
        ):  # the other one responds with the interpreter's lock
            options = replace(options, executor=ExecutorKind.SINGLE)
        super().__init__(options, *more, **keywords)

    def create_caller(self, topic: str, qos: Qos) -> Publisher[CallMessage]:
        if topic.endswith(RELAY_SUFFIX):
            self._response = _Response()
            return self._response
        kind = _ActionClient if self.options.call is Call.ACTION else _ServiceClient
        return kind(self._node, topic, qos, self._take_response, self.options.response_bytes)

    def create_server(self, topic: str, receive: Receive[CallMessage], qos: Qos) -> Subscription:
        if topic.endswith(RELAY_SUFFIX):
            self._take_response = receive
            return NodeSubscription(lambda: None)
        response = self._response

        def respond(stamp: str, payload_bytes: int) -> str:
            response.stamp = ""
            receive(CallMessage(stamp, payload_bytes=payload_bytes))
            return response.stamp

        serve = _serve_action if self.options.call is Call.ACTION else _serve_service
        size = requested_bytes(self.options.call, self.options.response_bytes)
        return NodeSubscription(serve(self._node, topic, qos_profile(qos), respond, size))

    def look_at(self, topic: str) -> TopicView:
        name = topic.removesuffix(RELAY_SUFFIX) + ("/_action/send_goal" if self.options.call is Call.ACTION else "")
        servers = self._node.count_services(name) * (Endpoint("server", ""),)
        return TopicView(topic, servers, servers)


class _Response:
    stamp = ""

    def publish(self, message: CallMessage, /) -> None:
        self.stamp = message.stamp

    def close(self) -> None:
        """Do nothing: the server closes."""


def _conversion_ns(*messages: RosMessage) -> int:
    client, times_ns = import_module("rclpy.serialization"), []
    for _ in range(CONVERSIONS):
        began_ns = time.monotonic_ns()
        for message in messages:
            client.deserialize_message(client.serialize_message(message), type(message))
        times_ns.append(time.monotonic_ns() - began_ns)
    return round(statistics.median(times_ns))


class _ServiceClient:
    def __init__(
        self, node: Any, name: str, qos: Qos, receive: Receive[CallMessage], response_bytes: int | None
    ) -> None:
        service = message_class(SERVICE)
        self._has_own_size = response_bytes is not None
        self._client = node.create_client(service, name, qos_profile=qos_profile(qos))
        self.close = partial(node.destroy_client, self._client)
        self.is_matched = self._client.service_is_ready
        self._receive = receive
        self._request, self._response = service.Request(), service.Response()

    def publish(self, message: CallMessage, /) -> None:
        if message.built is None:
            kinds = import_module("rcl_interfaces.msg")
            data = array("q", bytes(message.data) + bytes(-len(message.data) % 8))
            value = kinds.ParameterValue(
                type=INTEGER_ARRAY, integer_array_value=data, integer_value=message.payload_bytes
            )
            message.built = message_class(SERVICE).Request(parameters=[kinds.Parameter(value=value)])
        self._request = message.built
        self._request.parameters[0].name = message.stamp
        around_bytes = 0  # beyond the payload, in a response as long as its request
        if not self._has_own_size:
            around_bytes = -(-len(message.data) // 8) * 8 - message.payload_bytes
        self._client.call_async(self._request).add_done_callback(partial(self._on_response, around_bytes))

    def _on_response(self, around_bytes: int, future: Any) -> None:
        self._response = response = future.result()
        text = response.results[0].reason if response.results else ""
        self._receive(CallMessage(text[:46], payload_bytes=max(text_bytes(text) - around_bytes, 0)))

    def describe(self) -> dict[str, int]:
        return {"typed_ns": _conversion_ns(self._request, self._response)}


def _serve_service(
    node: Any, name: str, profile: Any, respond: Callable[[str, int], str], response_bytes: int | None
) -> Callable[[], None]:
    result = import_module("rcl_interfaces.msg").SetParametersResult(successful=True)
    filling = ""

    def on_request(request: Any, response: Any) -> Any:
        nonlocal filling
        for parameter in request.parameters[:1]:
            result.reason = respond(parameter.name, parameter.value.integer_value & _UINT32)
            size = (response_bytes or 8 * len(parameter.value.integer_array_value)) - len(result.reason)
            if len(filling) != max(size, 0):
                filling = size * "."
            result.reason += filling
            response.results = [result]
        return response

    service = node.create_service(message_class(SERVICE), name, on_request, qos_profile=profile)
    return partial(node.destroy_service, service)


class _ActionClient:
    def __init__(
        self, node: Any, name: str, qos: Qos, receive: Receive[CallMessage], _response_bytes: int | None
    ) -> None:
        action, profile = message_class(ACTION), qos_profile(qos)
        profiles = dict.fromkeys(
            (f"{part}_qos_profile" for part in ("goal_service", "result_service", "feedback_sub")), profile
        )
        self._client = import_module("rclpy.action").ActionClient(node, action, name, **profiles)
        # rclpy 7.1 registers a goal after it was sent: a response that is taken before that is ignored.
        self._lock, take = threading.Lock(), self._client.take_data
        self._client.take_data = partial(self._locked, take)
        self.close = self._client.destroy
        self.is_matched = self._client.server_is_ready
        self._receive = receive
        self._goal, self._result = action.Goal(), action.Result()
        self._id = message_class("unique_identifier_msgs/msg/UUID")
        self._times_ns: dict[str, list[int]] = defaultdict(list)

    def publish(self, message: CallMessage, /) -> None:
        stamp, sent_ns = message.stamp, time.monotonic_ns()
        goal_id = self._id(uuid=list(bytes.fromhex(stamp[4:20] + stamp[21:37])))
        on_feedback = partial(self._note, "feedback", stamp, sent_ns)
        future = self._locked(partial(self._client.send_goal_async, self._goal, on_feedback, goal_id))
        future.add_done_callback(partial(self._on_accepted, stamp, sent_ns))

    def _locked(self, work: Callable[[], Any]) -> Any:
        with self._lock:
            return work()

    def _note(self, step: str, stamp: str, sent_ns: int, _message: object = None) -> None:
        if not stamp.startswith(_PROBE):
            self._times_ns[step].append(time.monotonic_ns() - sent_ns)

    def _on_accepted(self, stamp: str, sent_ns: int, future: Any) -> None:
        self._note("accepted", stamp, sent_ns)
        if future.result().accepted:
            future.result().get_result_async().add_done_callback(partial(self._on_result, stamp))

    def _on_result(self, stamp: str, future: Any) -> None:
        self._result = future.result().result
        first = self._result.sequence[:1]
        text = f"{stamp[:-8]}{first[0] & _UINT32:08x}" if first else ""
        self._receive(CallMessage(text, payload_bytes=4 * len(self._result.sequence)))

    def describe(self) -> dict[str, int]:
        steps = {f"{step}_p50_ns": round(statistics.median(times)) for step, times in self._times_ns.items()}
        return {"typed_ns": _conversion_ns(self._goal, self._result), **steps}


def _serve_action(
    node: Any, name: str, profile: Any, respond: Callable[[str, int], str], response_bytes: int | None
) -> Callable[[], None]:
    action = message_class(ACTION)
    profiles = dict.fromkeys(
        (f"{part}_qos_profile" for part in ("goal_service", "result_service", "feedback_pub")), profile
    )
    numbers = array("i", bytes(response_bytes or 4))

    def execute(goal_handle: Any) -> Any:
        digits = bytes(goal_handle.goal_id.uuid).hex()
        stamp = respond(f"dt1:{digits[:16]}:{digits[16:]}:{0:08x}", 4)
        numbers[0] = int.from_bytes(bytes.fromhex(stamp[-8:]), "big", signed=True)
        goal_handle.publish_feedback(action.Feedback(sequence=numbers[:1]))
        goal_handle.succeed()
        return action.Result(sequence=numbers)

    actions = import_module("rclpy.action")
    close: Callable[[], None] = actions.ActionServer(
        node, action, name, execute, result_timeout=RESULT_KEPT_S, **profiles
    ).destroy
    return close
