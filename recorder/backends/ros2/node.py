"""A node of rclpy; only this file imports it."""

# ruff: noqa: PLC0415 - rclpy's import may end the process; `check_installed` tries it in another

from __future__ import annotations

import inspect
import os
import signal
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, cast

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.tracefile.format.descriptions import Qos

from ...applied.vendors import ros_middleware
from ...choices import ExecutorKind
from ..node import LAST_ACKNOWLEDGEMENT_S, ROUND_S, Endpoint, Publication, ThreadedNode, TopicView
from ..other_side import NOT_TEXT
from ..qos import DURATION_POLICIES, duration_extra, incompatible_pairs, other_definitions, requested_durations
from .fastdds_profile import send_unlocked, send_when_free, uses_tcp
from .installation import describe_middleware, message_class

if TYPE_CHECKING:
    from ..node import NodeOptions, Publisher, RawMessage, Receive, RosMessage, Subscription, TapReceive, TopicPatterns

GUID_BYTES = 16
_FAST_DDS, _HOST_BYTES = b"\x01\x0f", 4
"""First bytes of the GUIDs of Fast DDS: the vendor, then a number of the host."""
MOST_TYPES = 4
"""Types of a topic that a tap joins, each with a participant of its own."""
UNKNOWN_SEQUENCE = (1 << 64) - 1
"""RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED of `rmw/types.h`."""


class Ros2Node(ThreadedNode):
    """One rclpy node with its context, executor and thread, also an `ObjectNode`."""

    def __init__(
        self,
        options: NodeOptions,
        settings: Mapping[str, str] | None = None,
        on_closed: Callable[[], None] | None = None,
    ) -> None:
        rclpy = _rclpy()
        super().__init__(options)
        self._on_closed = on_closed
        if uses_tcp(options):
            send_unlocked()
        self._context = rclpy.Context()
        rclpy.logging.set_logger_level("rcl", rclpy.logging.LoggingSeverity.WARN)  # names the folder of keys at INFO
        try:
            rclpy.init(context=self._context, domain_id=options.domain_id)
        except RuntimeError as err:  # RCLError: keys of a secured domain, a broken configuration
            raise BackendUnavailableError(f"ROS 2 cannot start: {str(err).splitlines()[0]}") from err
        try:
            self._node = rclpy.create_node(
                options.name, context=self._context, enable_rosout=False, start_parameter_services=False
            )
        except Exception as err:
            rclpy.shutdown(context=self._context)
            if options.keys is None:
                static_peers = os.environ.get("ROS_STATIC_PEERS")
                peers = f" (ROS_STATIC_PEERS is {static_peers})" if static_peers else ""
                raise BackendUnavailableError(f"ROS 2 cannot open a node: {str(err).splitlines()[0]}{peers}") from err
            raise BackendUnavailableError(
                f"-o security={options.security.value}: {running_rmw()} has no security here, as no ROS 2 from pip has "
                f"({str(err).splitlines()[0]}); use a ROS 2 from apt, or --backend cyclonedds, zenoh or socket"
            ) from err
        self._executor, executor_name = _make_executor(options.executor, self._context)
        self._executor.add_node(self._node)
        self._middleware = describe_middleware(options, running_rmw(), executor_name, settings or {})
        self._publishers: list[_ObjectPublisher] = []
        # The EventsExecutor takes one message a notification, and Fast DDS notifies once of several (a late fragment).
        self._takes_left = executor_name == "events"
        self._subscriptions: tuple[_Ros2Subscription, ...] = ()
        self._incompatible: dict[str, set[str]] = {}
        self.tapped: dict[str, str] = {}
        self._further: tuple[Ros2Node, ...] = ()

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RawMessage]:
        return self._open_publisher(_RawPublisher, topic, type_name, qos)

    def create_object_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RosMessage]:
        return self._open_publisher(_ObjectPublisher, topic, type_name, qos)

    def _open_publisher(
        self, kind: type[_ObjectPublisher], topic: str, type_name: str, qos: Qos | None
    ) -> _ObjectPublisher:
        publisher = self._node.create_publisher(
            message_class(type_name),
            topic,
            qos_profile(qos or self.options.qos),
            event_callbacks=_events("PublisherEventCallbacks", self._on_incompatible(topic, "subscription")),
        )
        opened = kind(self._node, publisher)
        self._publishers.append(opened)
        return opened

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        return self._open_subscription(topic, type_name, receive, qos, raw=True)

    def create_object_subscription(
        self, topic: str, type_name: str, receive: Receive[RosMessage], *, qos: Qos | None = None
    ) -> Subscription:
        return self._open_subscription(topic, type_name, receive, qos, raw=False)

    def _open_subscription(
        self, topic: str, type_name: str, receive: Receive[Any], qos: Qos | None, *, raw: bool
    ) -> _Ros2Subscription:
        on_message = _with_info(receive, stamps_reception=ros_middleware(running_rmw()).stamps_reception)
        return self._subscribe(topic, type_name, on_message, qos or self.options.qos, raw=raw)

    def _subscribe(
        self, topic: str, type_name: str, on_message: Callable[..., None], qos: Qos, *, raw: bool = True
    ) -> _Ros2Subscription:
        subscription = self._node.create_subscription(
            message_class(type_name),
            topic,
            on_message,
            qos_profile(qos),
            raw=raw,
            event_callbacks=_events("SubscriptionEventCallbacks", self._on_incompatible(topic, "publisher")),
        )
        opened = _Ros2Subscription(self, subscription, on_message)
        self._subscriptions += (opened,)
        return opened

    def list_publications(self, matches: TopicPatterns) -> list[Publication]:
        self.error = next((node.error for node in (self, *self._further) if node.error is not None), None)
        infos = self._infos("/parameter_events") or []
        own_gid = next((bytes(info.endpoint_gid) for info in infos if info.node_name == self.options.name), b"")
        names = (named for named in self._names_and_types(matches.texts) if matches(named[0]))
        return [publication for named in names for publication in self._publications(*named, own_gid)]

    def _names_and_types(self, names: Sequence[str]) -> list[tuple[str, list[str]]]:
        """Return the graph's topics; where a name is not text, which fails the list, the topics of ROS nodes and of `names`."""
        try:
            return self._node.get_topic_names_and_types()  # type: ignore[no-any-return]
        except UnicodeDecodeError:
            self.strangers.count_once(NOT_TEXT)
        types_by_topic = {name: list[str]() for name in names if name.startswith("/") and not set(name) & set("*?[")}
        with suppress(UnicodeDecodeError):
            for node in self._node.get_node_names_and_namespaces():
                with suppress(Exception):  # it left, or this one is the stranger
                    types_by_topic.update(self._node.get_publisher_names_and_types_by_node(*node))
        return list(types_by_topic.items())

    def _infos(self, name: str) -> list[Any] | None:
        with suppress(Exception):  # not a name of ROS, or the name of a node is not text
            return self._node.get_publishers_info_by_topic(name)  # type: ignore[no-any-return]
        return None

    def _publications(self, name: str, types: Sequence[str], own_gid: bytes) -> list[Publication]:
        if (infos := self._infos(name)) is None:  # who joins it gets rclpy's reason
            return [Publication(name, type_name) for type_name in types]
        return [
            Publication(
                name,
                info.topic_type,
                (guid := bytes(info.endpoint_gid[:GUID_BYTES])).hex(),
                f"{info.node_namespace.rstrip('/')}/{info.node_name}",
                _endpoint(info).qos,
                own_gid[:_HOST_BYTES] == guid[:_HOST_BYTES] if own_gid[:2] == guid[:2] == _FAST_DDS else None,
            )
            for info in infos
            if info.node_name != self.options.name
        ]

    def create_tap(self, topic: str, type_name: str, receive: TapReceive, *, qos: Qos) -> Subscription:
        message_class(type_name)
        free = (node for node in (self, *self._further) if node.tapped.get(topic, type_name) == type_name)
        return (next(free, None) or self._open_further(topic)).open_tap(topic, type_name, receive, qos)

    def open_tap(self, topic: str, type_name: str, receive: TapReceive, qos: Qos) -> _Ros2Subscription:
        stamps_reception = ros_middleware(running_rmw()).stamps_reception
        opened = self._subscribe(topic, type_name, _with_sequence(receive, stamps_reception=stamps_reception), qos)
        self.tapped[topic] = type_name
        return opened

    def _open_further(self, topic: str) -> Ros2Node:
        from .. import open_node

        if len(self._further) >= MOST_TYPES - 1:
            joined = ", ".join(node.tapped[topic] for node in (self, *self._further))
            raise OptionError(f"it is announced with more than {MOST_TYPES} types, and these are joined: {joined}")
        node = cast("Ros2Node", open_node("ros2", self.options))
        node.start()
        self._further += (node,)
        return node

    def publisher_of(self, source: Hashable) -> str | None:
        return source if isinstance(source, str) else None

    def members(self, type_name: str) -> Mapping[str, str] | None:
        return cast("Mapping[str, str]", message_class(type_name).get_fields_and_field_types())

    def destroy_subscription(self, subscription: _Ros2Subscription) -> None:
        self._subscriptions = tuple(other for other in self._subscriptions if other is not subscription)
        self._node.destroy_subscription(subscription.subscription)

    def message_from_cdr(self, type_name: str, data: RawMessage) -> RosMessage:
        return _rclpy().serialization.deserialize_message(bytes(data), message_class(type_name))

    def message_to_cdr(self, message: RosMessage) -> bytes:
        return bytes(_rclpy().serialization.serialize_message(message))

    def read_security(self) -> str:
        # Under it no node opens without keys and plugins.
        return "ROS_SECURITY_STRATEGY=Enforce" if self.options.keys is not None else ""

    def _make_round(self) -> Callable[[], None]:
        # EventsExecutor.spin() delivers nothing in a thread. One call makes at most one callback.
        spin_once = partial(self._executor.spin_once, timeout_sec=ROUND_S)
        if not self._takes_left:
            return spin_once

        def receive_round() -> None:
            spin_once()
            for subscription in self._subscriptions:
                subscription.take_left()

        return receive_round

    def _on_incompatible(self, topic: str, other: str) -> Callable[[Any], None]:
        def note(event: Any) -> None:
            policy = str(event.last_policy_kind).rpartition("_")[2].lower()
            self._incompatible.setdefault(topic, set()).add(f"{topic}: a {other} differs in {policy}")

        return note

    def look_at(self, topic: str) -> TopicView:
        publishing = self._node.get_publishers_info_by_topic(topic)
        subscribed = self._node.get_subscriptions_info_by_topic(topic)
        publishers, subscriptions = tuple(map(_endpoint, publishing)), tuple(map(_endpoint, subscribed))
        pairs = tuple(incompatible_pairs(topic, publishers, subscriptions, self.options.name))
        if pairs:  # they say more about the mismatches of the events
            self._incompatible[topic] = set()
        return TopicView(
            topic,
            publishers,
            subscriptions,
            pairs or tuple(sorted(self._incompatible.get(topic, ()))),
            tuple(other_definitions(topic, [*publishing, *subscribed], self.options.name)),
        )

    def participant_names(self) -> list[str]:
        return [name for name, _ in self._node.get_node_names_and_namespaces()]

    def _wake(self) -> None:
        if self._thread is not None:
            self._executor.wake()

    def _stop_receiving(self, timeout_s: float | None) -> None:
        for node in self._further:
            node.stop_receiving(timeout_s)
        super()._stop_receiving(timeout_s)

    def _leave(self) -> None:
        for node in self._further:
            node.close()
        for publisher in self._publishers:
            publisher.wait_until_acknowledged()
        with _python_signal_handlers():
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()
            del self._executor
        if self._on_closed is not None:
            self._on_closed()


class _ObjectPublisher:
    def __init__(self, node: Any, publisher: Any) -> None:
        self._node = node
        self.publisher = publisher

    def publish(self, message: RosMessage, /) -> None:
        try:
            self.publisher.publish(message)
        except (RuntimeError, BackendUnavailableError):
            send_when_free(partial(self.publisher.publish, message))

    def wait_until_acknowledged(self) -> None:
        duration = _rclpy().duration.Duration(seconds=LAST_ACKNOWLEDGEMENT_S)
        with suppress(Exception):  # it is closed, or an older rclpy cannot wait
            self.publisher.wait_for_all_acked(duration)

    def close(self) -> None:
        self._node.destroy_publisher(self.publisher)


class _RawPublisher(_ObjectPublisher):
    def __init__(self, node: Any, publisher: Any) -> None:
        super().__init__(node, publisher)
        self._handle = publisher.handle

    def publish(self, message: RawMessage, /) -> None:
        # Publisher.publish takes a copy in `bytes`; the binding below it also a bytearray, since pybind11 2.10.
        try:
            with self._handle:
                self._handle.publish_raw(message)
        except (TypeError, RuntimeError, BackendUnavailableError):
            super().publish(bytes(message))


@dataclass(slots=True)
class _Ros2Subscription:
    node: Ros2Node
    subscription: Any
    on_message: Callable[..., None]
    last_left: Any = None

    def take_left(self) -> None:
        """Deliver messages without a notification; Fast DDS may return one for ever, which counts once."""
        subscription = self.subscription
        handle = subscription.handle
        with suppress(_rclpy().exceptions.InvalidHandle), handle:  # the subscription was closed
            while (message := handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                if message[1] == self.last_left:
                    return
                self.on_message(*message)
                self.last_left = message[1]

    def close(self) -> None:
        self.node.destroy_subscription(self)


def _rclpy() -> Any:
    import rclpy
    import rclpy.duration
    import rclpy.exceptions
    import rclpy.executors
    import rclpy.logging
    import rclpy.qos
    import rclpy.serialization
    import rclpy.subscription
    import rclpy.utilities

    return rclpy


def running_rmw() -> str:
    return str(_rclpy().utilities.get_rmw_implementation_identifier())


@contextmanager
def _python_signal_handlers() -> Iterator[None]:
    """Restore Python's handlers of SIGINT and SIGTERM, which the EventsExecutor replaces."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in handlers.items():
                signal.signal(number, handler)


def _make_executor(kind: ExecutorKind, context: Any) -> tuple[Any, str]:
    events = None
    if find_spec("rclpy.experimental") is not None:
        events = getattr(import_module("rclpy.experimental"), "EventsExecutor", None)
    if kind is ExecutorKind.EVENTS and events is None:
        raise BackendUnavailableError(
            "this rclpy has no EventsExecutor (ROS 2 Jazzy and later have it); use -o executor=single"
        )
    if kind is not ExecutorKind.SINGLE and events is not None:
        with _python_signal_handlers():
            return events(context=context), "events"
    return _rclpy().executors.SingleThreadedExecutor(context=context), "single"


def _with_info(receive: Receive[Any], *, stamps_reception: bool) -> Callable[..., None]:
    """Return `receive` as rclpy calls it; without `stamps_reception` its second time stamp is 0."""
    if not hasattr(_rclpy().subscription.Subscription, "CallbackType"):
        return receive  # Humble

    def on_message(message: Any, info: Any = None) -> None:
        if info is None:  # the EventsExecutor of Jazzy passes the pair as one argument
            message, info = message
        receive(message, info["source_timestamp"], info["received_timestamp"] if stamps_reception else 0)

    return _of_two_parameters(on_message)


def _of_two_parameters(on_message: Callable[..., None]) -> Callable[..., None]:
    parameter = inspect.Parameter
    on_message.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [parameter(name, parameter.POSITIONAL_ONLY) for name in ("message", "info")]
    )
    return on_message


def _with_sequence(receive: TapReceive, *, stamps_reception: bool) -> Callable[..., None]:
    if not hasattr(_rclpy().subscription.Subscription, "CallbackType"):
        return lambda message: receive(message, 0, 0, 0, None)  # Humble

    def on_message(message: Any, info: Any = None) -> None:
        if info is None:
            message, info = message
        sequence = info.get("publication_sequence_number", UNKNOWN_SEQUENCE)
        sequence = 0 if sequence == UNKNOWN_SEQUENCE else sequence
        received_ns = info["received_timestamp"] if stamps_reception else 0
        gid = (info.get("publisher_gid") or {}).get("data")  # Kilted and later
        source = bytes(gid)[:GUID_BYTES].hex() if gid else None
        receive(message, info["source_timestamp"], received_ns, sequence, source)

    return _of_two_parameters(on_message)


def _events(class_name: str, on_incompatible: Callable[[Any], None]) -> Any:
    module = "rclpy.event_handler" if find_spec("rclpy.event_handler") else "rclpy.qos_event"  # Humble
    return getattr(import_module(module), class_name)(incompatible_qos=on_incompatible, use_default_callbacks=False)


def qos_profile(qos: Qos) -> Any:
    kinds = _rclpy().qos
    try:
        return kinds.QoSProfile(
            reliability=kinds.ReliabilityPolicy[qos.reliability.upper()],
            durability=kinds.DurabilityPolicy[qos.durability.upper()],
            history=kinds.HistoryPolicy[qos.history.upper()],
            depth=qos.depth,
            **{
                policy: _rclpy().duration.Duration(nanoseconds=duration_ns)
                for policy, duration_ns in requested_durations(qos).items()
            },
        )
    except KeyError as err:
        raise OptionError(f"ROS 2 has no quality of service {err}") from err


def _endpoint(info: Any) -> Endpoint:
    profile = info.qos_profile
    reliability, durability, history = (
        getattr(profile, policy).name.lower() for policy in ("reliability", "durability", "history")
    )
    durations = duration_extra({policy: getattr(profile, policy).nanoseconds for policy in DURATION_POLICIES})
    return Endpoint(info.node_name, info.topic_type, Qos(reliability, durability, history, profile.depth, durations))
