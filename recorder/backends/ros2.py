"""`ros2`: nodes of the ROS 2 that is on this machine, with whatever middleware it runs on (apt or wheels).

The only file that imports rclpy. Written for rclpy of Humble to Kilted; what older ones lack is asked for
where it is used.
"""

# ruff: noqa: PLC0415 - rclpy's import may end the process, so it waits until that was tried elsewhere

from __future__ import annotations

import inspect
import os
import re
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import BackendUnavailableError, OptionError, Qos

from .base import (
    Discovery,
    Endpoint,
    ExecutorKind,
    Middleware,
    TopicView,
    Transport,
)
from .checks import refuse_peers
from .qos import (
    DURATION_POLICIES,
    asked_durations,
    duration_extra,
    incompatible_pairs,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from .base import (
        Node,
        NodeOptions,
        Publisher,
        RawMessage,
        Receive,
        Subscription,
    )

SPIN_S = 0.1
"""One round of the executor; how long `close` may have to wait for the thread."""
LAST_ACKNOWLEDGEMENT_S = 0.5
WRONG_RMW_TIMEOUT_S = 30.0

INSTALL = (
    "pip install 'dds-trace[ros2]' (wheels, x86_64), or install ROS 2 from apt and run "
    "`source /opt/ros/$ROS_DISTRO/setup.bash` in this terminal (the Python of that ROS 2 must run dds-trace)"
)


@dataclass(frozen=True, slots=True)
class _Vendor:
    """A DDS vendor behind a ROS middleware, and the ROS packages that tell its version."""

    name: str
    packages: tuple[str, ...]


VENDORS = {
    "rmw_fastrtps_cpp": _Vendor("fastdds", ("fastrtps", "fastdds", "rmw_fastrtps_cpp")),
    "rmw_fastrtps_dynamic_cpp": _Vendor("fastdds", ("fastrtps", "fastdds", "rmw_fastrtps_dynamic_cpp")),
    "rmw_cyclonedds_cpp": _Vendor("cyclonedds", ("cyclonedds", "rmw_cyclonedds_cpp")),
    "rmw_connextdds": _Vendor("connext", ("rti_connext_dds_cmake_module", "rmw_connextdds")),
    "rmw_zenoh_cpp": _Vendor("zenoh", ("zenoh_cpp_vendor", "rmw_zenoh_cpp")),
}

# Values of FASTDDS_BUILTIN_TRANSPORTS by (transport, tuned); None leaves the user's own value in place.
FASTDDS_TRANSPORTS = {
    (Transport.DEFAULT, False): None,
    (Transport.UDP, False): "UDPv4",
    (Transport.SHM, False): "SHM",
    (Transport.LARGE_DATA, False): "LARGE_DATA",
    (Transport.DEFAULT, True): "UDPv4?sockets_size=4MB",
    (Transport.UDP, True): "UDPv4?sockets_size=4MB",
}


class Ros2Backend:
    """ROS 2 through rclpy; see `Backend` for the names."""

    name = "ros2"

    def open_node(self, options: NodeOptions) -> Node:
        """A node in a context of its own, so that several domains fit in one process."""
        refuse_peers(self.name, options)
        if options.rmw is not None:
            os.environ["RMW_IMPLEMENTATION"] = options.rmw
        _check_installed()
        _set_environment(options)
        try:
            return Ros2Node(options)
        except ImportError as err:  # a half-sourced installation: the package is there, its libraries are not
            raise BackendUnavailableError(f"ROS 2 cannot be loaded ({err}); {INSTALL}") from err


BACKEND = Ros2Backend()


class Ros2Node:
    """One rclpy node with its context, executor and thread; see `Node` for the names."""

    def __init__(self, options: NodeOptions) -> None:
        rclpy = _rclpy()
        self._options = options
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=options.domain_id)
        self._node = rclpy.create_node(
            options.name, context=self._context, enable_rosout=False, start_parameter_services=False
        )
        self._executor, executor_name = _make_executor(options.executor, self._context)
        self._executor.add_node(self._node)
        self._middleware = _describe_middleware(options, executor_name)
        self._publishers: list[_Ros2Publisher] = []
        # The EventsExecutor takes one message for each notification, and Fast DDS notifies once when several
        # messages become readable together (a lost fragment came at last): the others would wait in the reader
        # until as many later ones arrive, for ever that far behind.
        self._takes_left = executor_name == "events"
        self._subscriptions: tuple[_Ros2Subscription, ...] = ()
        self._incompatible: dict[str, set[str]] = {}
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._error: BaseException | None = None

    @property
    def options(self) -> NodeOptions:
        """What the node was opened with."""
        return self._options

    @property
    def middleware(self) -> Middleware:
        """What carries the messages."""
        return self._middleware

    def create_publisher(
        self, topic: str, type_name: str, *, qos: Qos | None = None, typed: bool = False
    ) -> Publisher:
        """A publisher of bytes, or of message objects if `typed`."""
        publisher = self._node.create_publisher(
            _message_class(type_name),
            topic,
            _qos_profile(qos or self._options.qos),
            event_callbacks=_events("PublisherEventCallbacks", self._on_incompatible(topic, "subscription")),
        )
        made = (_Ros2Publisher if typed else _RawPublisher)(self._node, publisher)
        self._publishers.append(made)
        return made

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive, *, qos: Qos | None = None, typed: bool = False
    ) -> Subscription:
        """A subscription of bytes, or of message objects if `typed`."""
        on_message = _with_info(receive)
        subscription = self._node.create_subscription(
            _message_class(type_name),
            topic,
            on_message,
            _qos_profile(qos or self._options.qos),
            raw=not typed,
            event_callbacks=_events("SubscriptionEventCallbacks", self._on_incompatible(topic, "publisher")),
        )
        made = _Ros2Subscription(self, subscription, on_message)
        self._subscriptions += (made,)
        return made

    def destroy_subscription(self, subscription: _Ros2Subscription) -> None:
        """Once; nothing is taken from it any more."""
        self._subscriptions = tuple(other for other in self._subscriptions if other is not subscription)
        self._node.destroy_subscription(subscription.subscription)

    def message_from_cdr(self, type_name: str, data: RawMessage) -> Any:
        """The message object."""
        return _rclpy().serialization.deserialize_message(bytes(data), _message_class(type_name))

    def message_to_cdr(self, message: Any) -> bytes:
        """The serialized message."""
        return bytes(_rclpy().serialization.serialize_message(message))

    def start(self) -> None:
        """Start the thread that spins the executor."""
        self._thread = threading.Thread(target=self._spin, name=f"ros2-domain-{self._options.domain_id}")
        self._thread.daemon = True
        self._thread.start()

    def _spin(self) -> None:
        spin_once = self._executor.spin_once  # EventsExecutor.spin() delivered nothing in a thread
        try:
            while not self._stopping:
                spin_once(timeout_sec=SPIN_S)  # one callback, or none in that time
                if self._takes_left:
                    for subscription in self._subscriptions:
                        subscription.take_left()
        except BaseException as error:  # noqa: BLE001 - kept for whoever looks at the node; a thread has no caller
            self._error = error

    @property
    def error(self) -> BaseException | None:
        """What ended the thread."""
        return self._error

    def _on_incompatible(self, topic: str, other: str) -> Callable[[Any], None]:
        def note(event: Any) -> None:
            policy = str(event.last_policy_kind).rpartition("_")[2].lower()
            self._incompatible.setdefault(topic, set()).add(f"{topic}: a {other} differs in {policy}")

        return note

    def look_at(self, topic: str) -> TopicView:
        """Endpoints as the ROS graph knows them; mismatches from there and from the middleware's events."""
        publishers = tuple(map(_endpoint, self._node.get_publishers_info_by_topic(topic)))
        subscriptions = tuple(map(_endpoint, self._node.get_subscriptions_info_by_topic(topic)))
        named = tuple(incompatible_pairs(topic, publishers, subscriptions, self._options.name))
        if named:  # the same that the events told, in better words
            self._incompatible[topic] = set()
        return TopicView(
            topic, publishers, subscriptions, named or tuple(sorted(self._incompatible.get(topic, ())))
        )

    def count_participants(self) -> int | None:
        """Nodes in the ROS graph."""
        return len(self._node.get_node_names_and_namespaces())

    def close(self) -> None:
        """Stop the thread, wait for acknowledgements of the last messages, leave the domain."""
        if self._stopping:
            return
        self._stopping = True
        if self._thread is not None:
            self._executor.wake()
            self._thread.join()
        for publisher in self._publishers:
            publisher.wait_until_acknowledged()
        with _python_signal_handlers():
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()
            del self._executor

    def __enter__(self) -> Ros2Node:  # noqa: PYI034 - `Self` is Python 3.11's
        """The node itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()


class _Ros2Publisher:
    """Publishes message objects."""

    def __init__(self, node: Any, publisher: Any) -> None:
        self._node = node
        self._publisher = publisher
        self._handle = publisher.handle

    def publish(self, message: Any, /) -> None:
        self._publisher.publish(message)

    def wait_until_acknowledged(self) -> None:
        """A node that quits at once loses its last messages."""
        duration = _rclpy().duration.Duration(seconds=LAST_ACKNOWLEDGEMENT_S)
        with suppress(Exception):  # closed before, or an older rclpy: nothing to wait for
            self._publisher.wait_for_all_acked(duration)

    def close(self) -> None:
        self._node.destroy_publisher(self._publisher)


class _RawPublisher(_Ros2Publisher):
    """Publishes serialized messages."""

    def publish(self, message: RawMessage, /) -> None:
        # Publisher.publish takes `bytes` alone, which would cost a copy between T1 and the middleware; the
        # binding below it takes a bytearray as well since pybind11 2.10.
        try:
            with self._handle:
                self._handle.publish_raw(message)
        except TypeError:
            self._publisher.publish(bytes(message))


@dataclass(slots=True)
class _Ros2Subscription:
    node: Ros2Node
    subscription: Any
    on_message: Callable[..., None]
    last_left: Any = None
    """Time stamps of the message that was handed on last."""

    def take_left(self) -> None:
        """Hand on what is readable and was not notified.

        Fast DDS may give one message without end: of a reader that waits for the rest of a large message whose writer
        is gone, the first one stays where it is. It is handed on once.
        """
        subscription = self.subscription
        handle = subscription.handle
        with suppress(_rclpy().exceptions.InvalidHandle), handle:  # closed meanwhile
            while (taken := handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                if taken[1] == self.last_left:
                    return
                self.on_message(*taken)
                self.last_left = taken[1]

    def close(self) -> None:
        self.node.destroy_subscription(self)


def _rclpy() -> Any:
    """The client library, imported at first use, behind `_check_installed`."""
    import rclpy
    import rclpy.duration
    import rclpy.exceptions
    import rclpy.executors
    import rclpy.qos
    import rclpy.serialization
    import rclpy.subscription
    import rclpy.utilities

    return rclpy


def _check_installed() -> None:
    if find_spec("rclpy") is None:
        raise BackendUnavailableError(f"ROS 2's Python client rclpy is not installed; {INSTALL}")
    wanted = os.environ.get("RMW_IMPLEMENTATION")
    if not wanted or "rclpy" in sys.modules:
        return
    # With a middleware that it was not built for, rclpy ends the whole process (status 102) as soon as it is
    # imported; so another process tries it first.
    ask = "from rclpy.utilities import get_rmw_implementation_identifier as name; print(name())"
    tried = subprocess.run(
        [sys.executable, "-c", ask], capture_output=True, text=True, timeout=WRONG_RMW_TIMEOUT_S, check=False
    )
    found = tried.stdout.strip()
    if found != wanted:
        reason = (tried.stderr.strip().splitlines() or [f"{found} is what runs here"])[-1]
        raise BackendUnavailableError(
            f"RMW_IMPLEMENTATION={wanted} does not work here: {reason}; unset it, or install that middleware "
            f"(apt install ros-$ROS_DISTRO-{wanted.replace('_', '-')}; the wheels have Fast DDS alone)"
        )


def _set_environment(options: NodeOptions) -> None:
    """What rclpy and Fast DDS read from the environment when a context and its node are made."""
    localhost = options.discovery is Discovery.LOCALHOST
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST" if localhost else "SUBNET"
    # Iron and later know the range, and warn when they meet the older variable; Humble knows that one alone.
    if find_spec("rclpy.event_handler") is None:
        os.environ["ROS_LOCALHOST_ONLY"] = "1" if localhost else "0"
    else:
        os.environ.pop("ROS_LOCALHOST_ONLY", None)
    chosen = (options.transport, options.tuned)
    if chosen not in FASTDDS_TRANSPORTS:
        raise OptionError(
            f"no settings for large messages are known for the transport {options.transport.value}"
        )
    if (value := FASTDDS_TRANSPORTS[chosen]) is not None:
        identifier = _rclpy().utilities.get_rmw_implementation_identifier()
        if _vendor(identifier).name != "fastdds":
            raise OptionError(f"transport and tuning are Fast DDS's, and the middleware here is {identifier}")
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = value


class _python_signal_handlers:  # noqa: N801 - used as a function
    """Puts Python's handlers of SIGINT and SIGTERM back after a block in which the EventsExecutor takes them."""

    _signals = (signal.SIGINT, signal.SIGTERM)

    def __enter__(self) -> None:
        self._handlers = [signal.getsignal(number) for number in self._signals]

    def __exit__(self, *_: object) -> None:
        if threading.current_thread() is threading.main_thread():
            for number, handler in zip(self._signals, self._handlers, strict=True):
                signal.signal(number, handler)


def _make_executor(kind: ExecutorKind, context: Any) -> tuple[Any, str]:
    events = None
    if find_spec("rclpy.experimental") is not None:
        events = getattr(import_module("rclpy.experimental"), "EventsExecutor", None)
    if kind is ExecutorKind.EVENTS and events is None:
        raise BackendUnavailableError(
            "this rclpy has no EventsExecutor (ROS 2 Jazzy and later have it); use --executor single"
        )
    if kind is not ExecutorKind.SINGLE and events is not None:
        with _python_signal_handlers():
            return events(context=context), "events"
    return _rclpy().executors.SingleThreadedExecutor(context=context), "single"


def _with_info(receive: Receive) -> Callable[..., None]:
    """`receive` as rclpy calls it, with the middleware's two time stamps where this rclpy gives them."""
    if not hasattr(_rclpy().subscription.Subscription, "CallbackType"):
        return receive  # Humble

    def on_message(message: Any, info: Any = None) -> None:
        if info is None:  # the EventsExecutor of Jazzy passes the pair as one argument
            message, info = message
        receive(message, info["source_timestamp"], info["received_timestamp"])

    # rclpy looks at the signature to learn whether the callback wants `info`: show it two needed parameters.
    parameter = inspect.Parameter
    on_message.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [parameter(name, parameter.POSITIONAL_ONLY) for name in ("message", "info")]
    )
    return on_message


def _events(class_name: str, on_incompatible: Callable[[Any], None]) -> Any:
    module = "rclpy.event_handler" if find_spec("rclpy.event_handler") else "rclpy.qos_event"  # Humble
    return getattr(import_module(module), class_name)(
        incompatible_qos=on_incompatible, use_default_callbacks=False
    )


def _message_class(type_name: str) -> Any:
    package, _, name = type_name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as err:
        raise BackendUnavailableError(
            f"the message type {type_name} is not installed; "
            f"apt install ros-$ROS_DISTRO-{package.replace('_', '-')}, or {INSTALL}"
        ) from err


def _qos_profile(qos: Qos) -> Any:
    kinds = _rclpy().qos
    try:
        return kinds.QoSProfile(
            reliability=kinds.ReliabilityPolicy[qos.reliability.upper()],
            durability=kinds.DurabilityPolicy[qos.durability.upper()],
            history=kinds.HistoryPolicy[qos.history.upper()],
            depth=qos.depth,
            **{
                policy: _rclpy().duration.Duration(nanoseconds=duration_ns)
                for policy, duration_ns in asked_durations(qos).items()
            },
        )
    except KeyError as err:
        raise OptionError(f"ROS 2 has no quality of service {err}") from err


def _endpoint(info: Any) -> Endpoint:
    profile = info.qos_profile
    return Endpoint(
        info.node_name,
        info.topic_type,
        Qos(
            profile.reliability.name.lower(),
            profile.durability.name.lower(),
            profile.history.name.lower(),
            profile.depth,
            duration_extra({policy: getattr(profile, policy).nanoseconds for policy in DURATION_POLICIES}),
        ),
    )


def _vendor(identifier: str) -> _Vendor:
    return VENDORS.get(
        identifier, _Vendor(identifier.removeprefix("rmw_").removesuffix("_cpp"), (identifier,))
    )


def _describe_middleware(options: NodeOptions, executor: str) -> Middleware:
    identifier = _rclpy().utilities.get_rmw_implementation_identifier()
    vendor = _vendor(identifier)
    versions = {name: _package_version(name) for name in ("rclpy", *vendor.packages)}
    settings = {
        "executor": executor,
        "discovery": options.discovery.value,
        "transport": options.transport.value,
        "tuned": str(options.tuned).lower(),
        "FASTDDS_BUILTIN_TRANSPORTS": os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", ""),
    }
    return Middleware(
        "ros2",
        vendor.name,
        identifier,
        {name: version for name, version in versions.items() if version},
        {name: value for name, value in settings.items() if value},
    )


def _package_version(package: str) -> str | None:
    """Version of a ROS package, from its wheel or from the installation's `package.xml`."""
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(f"ros-{package.replace('_', '-')}")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        with suppress(OSError):
            text = (Path(prefix) / "share" / package / "package.xml").read_text()
            if found := re.search(r"<version>\s*([^<\s]+)", text):
                return found[1]
    return None
