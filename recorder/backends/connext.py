"""`connext`: RTI Connext through `rti.connext`, with the topics and types of ROS 2.

Written by RTI's documentation; it starts a participant only with a licence, and without one it says so in a line.
Messages pass as they are serialized, in a DynamicData that holds CDR. The only file that imports rti.connextdds.
"""

from __future__ import annotations

import re
import threading
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import BackendUnavailableError, OptionError, Qos
from dds_trace.tracefile.units.durations import SECOND_NS

from .base import Discovery, Endpoint, Middleware, TopicView
from .checks import refuse_others_options, refuse_typed
from .dds_types import DDS_TYPES, check_known, dds_name, split_type
from .qos import asked_durations, duration_extra, incompatible_pairs

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

WAIT_S = 0.1
"""One round of the thread; how long `close` may have to wait for it."""
LAST_ACKNOWLEDGEMENT_S = 0.5
TUNED_PROPERTIES = {
    "dds.transport.UDPv4.builtin.recv_socket_buffer_size": "4000000",
    "dds.transport.UDPv4.builtin.send_socket_buffer_size": "4000000",
}
LOCALHOST_PROPERTIES = {"dds.transport.UDPv4.builtin.parent.allow_interfaces_list": "127.0.0.1"}
LOCALHOST_PEERS = ("builtin.udpv4://127.0.0.1", "builtin.shmem://")

INSTALL = "pip install 'dds-trace[connext]'"


class ConnextBackend:
    """RTI Connext; see `Backend` for the names."""

    name = "connext"

    def open_node(self, options: NodeOptions) -> Node:
        """A participant in its domain."""
        refuse_others_options(self.name, options)
        try:
            return ConnextNode(options)
        except ImportError as err:
            raise BackendUnavailableError(f"RTI Connext cannot be loaded ({err}); {INSTALL}") from err


BACKEND = ConnextBackend()


class ConnextNode:
    """One participant with its readers' thread; see `Node` for the names."""

    def __init__(self, options: NodeOptions) -> None:
        dds = _connext()
        self._options = options
        qos = dds.DomainParticipantQos()
        qos.participant_name.name = options.name
        properties = _properties(options)
        for name, value in properties.items():
            qos.property[name] = value
        if options.discovery is Discovery.LOCALHOST:
            qos.discovery.initial_peers = dds.StringSeq(list(LOCALHOST_PEERS))
            qos.discovery.multicast_receive_addresses = dds.StringSeq([])
        elif options.peers:
            qos.discovery.initial_peers = dds.StringSeq(list(options.peers))
        try:
            self._participant = dds.DomainParticipant(options.domain_id, qos)
        except dds.Error as err:
            raise BackendUnavailableError(
                "RTI Connext does not start a participant; it needs a licence: set RTI_LICENSE_FILE to the path of "
                f"your rti_license.dat (RTI's own reason is the line above; {err})"
            ) from err
        self._waitset = dds.WaitSet()
        self._readers: tuple[tuple[Any, Receive], ...] = ()
        self._writers: list[_ConnextPublisher] = []
        self._middleware = Middleware(
            "connext",
            "connext",
            None,
            {"rti.connext": metadata.version("rti.connext"), "connext": str(dds.ProductVersion.current)},
            {
                "discovery": options.discovery.value,
                "tuned": str(options.tuned).lower(),
                "publish_mode": "asynchronous",
                **properties,
            },
        )
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
        """A writer of bytes."""
        dds = _connext()
        refuse_typed("connext", typed)
        found, dynamic_type = self._topic(topic, type_name)
        kept = _fill(dds.DataWriterQos(), qos or self._options.qos)
        # Reliable messages of more than one datagram must be sent by a thread of Connext's (its chapter on large data).
        kept.publish_mode = dds.PublishMode.asynchronous()
        writer = dds.DynamicData.DataWriter(dds.Publisher(self._participant), found, kept)
        made = _ConnextPublisher(writer, dds.DynamicData(dynamic_type))
        self._writers.append(made)
        return made

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive, *, qos: Qos | None = None, typed: bool = False
    ) -> Subscription:
        """A reader of bytes."""
        dds = _connext()
        refuse_typed("connext", typed)
        found, _ = self._topic(topic, type_name)
        kept = _fill(dds.DataReaderQos(), qos or self._options.qos)
        reader = dds.DynamicData.DataReader(dds.Subscriber(self._participant), found, kept)
        condition = dds.StatusCondition(reader)
        condition.enabled_statuses = dds.StatusMask.DATA_AVAILABLE
        self._waitset += condition
        self._readers += ((reader, receive),)
        return _ConnextSubscription(partial(self._withdraw, reader, condition))

    def _topic(self, topic: str, type_name: str) -> tuple[Any, Any]:
        """The topic, made once, and its type; samples stay serialized."""
        dds = _connext()
        check_known("connext", type_name)
        dynamic_type = _dynamic_type(dds, type_name)
        name = "::".join((*dds_name(type_name)[:2], "dds_", dds_name(type_name)[2]))
        found = dds.DynamicData.Topic.find(self._participant, f"rt/{topic}")
        if found is None:
            if not self._participant.is_type_registered(name):
                serialized = dds.DynamicDataTypeSerializationProperty()
                serialized.skip_deserialization = True
                self._participant.register_type(name, dynamic_type, serialized)
            found = dds.DynamicData.Topic(self._participant, f"rt/{topic}", name, dds.TopicQos())
        return found, dynamic_type

    def _withdraw(self, reader: Any, condition: Any) -> None:
        if any(other is reader for other, _ in self._readers):
            self._readers = tuple(pair for pair in self._readers if pair[0] is not reader)
            self._waitset -= condition
            reader.close()

    def message_from_cdr(self, type_name: str, data: RawMessage) -> Any:
        """There are no message objects."""
        del type_name, data
        refuse_typed("connext", True)

    def start(self) -> None:
        """Start the thread that waits for data."""
        self._thread = threading.Thread(target=self._wait, name=f"connext-domain-{self._options.domain_id}")
        self._thread.daemon = True
        self._thread.start()

    def _wait(self) -> None:
        patience = _connext().Duration.from_milliseconds(round(WAIT_S * 1000))
        try:
            while not self._stopping:
                with suppress(_connext().TimeoutError):
                    self._waitset.wait(patience)
                for reader, receive in self._readers:
                    _take_all(reader, receive)
        except BaseException as error:  # noqa: BLE001 - kept for whoever looks at the node; a thread has no caller
            self._error = error

    @property
    def error(self) -> BaseException | None:
        """What ended the thread."""
        return self._error

    def look_at(self, topic: str) -> TopicView:
        """Endpoints as Connext has discovered them, and this node's own, which it does not list."""
        names = {str(key): name for key, name in self._participants()}
        asked = self._options.qos
        own = Qos(asked.reliability, asked.durability, "", 0, asked.extra)
        publishers = self._endpoints(self._participant.publication_reader, topic, names)
        subscriptions = self._endpoints(self._participant.subscription_reader, topic, names)
        publishers += [
            Endpoint(self._options.name, _ros_name(writer.writer.type_name), own)
            for writer in self._writers
            if not writer.writer.closed and writer.writer.topic_name == f"rt/{topic}"
        ]
        subscriptions += [
            Endpoint(self._options.name, _ros_name(reader.type_name), own)
            for reader, _ in self._readers
            if reader.topic_name == f"rt/{topic}"
        ]
        named = incompatible_pairs(topic, publishers, subscriptions, self._options.name)
        return TopicView(topic, tuple(publishers), tuple(subscriptions), tuple(named))

    def _participants(self) -> list[tuple[Any, str]]:
        found = [
            self._participant.discovered_participant_data(handle)
            for handle in self._participant.discovered_participants()
        ]
        return [(each.key, each.participant_name.name or "") for each in found]

    def _endpoints(self, reader: Any, topic: str, names: dict[str, str]) -> list[Endpoint]:
        return [
            Endpoint(
                names.get(str(found.participant_key), ""),
                _ros_name(found.type_name),
                _qos(found),
            )
            for found in reader.read_data()
            if found.topic_name == f"rt/{topic}"
        ]

    def count_participants(self) -> int | None:
        """Participants in the domain."""
        return 1 + len(self._participant.discovered_participants())

    def close(self) -> None:
        """Stop the thread, wait for acknowledgements of the last messages, leave the domain."""
        if self._stopping:
            return
        self._stopping = True
        if self._thread is not None:
            self._thread.join()
        for writer in self._writers:
            writer.wait_until_acknowledged()
        self._participant.close()

    def __enter__(self) -> ConnextNode:  # noqa: PYI034 - `Self` is Python 3.11's
        """The node itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()


@dataclass(frozen=True, slots=True)
class _ConnextPublisher:
    """Publishes serialized messages."""

    writer: Any
    sample: Any

    def publish(self, message: RawMessage, /) -> None:
        self.sample.set_cdr_buffer(message)
        self.writer.write(self.sample)

    def wait_until_acknowledged(self) -> None:
        """A participant that leaves at once takes its last messages with it."""
        with suppress(Exception):  # closed before: nothing to wait for
            self.writer.wait_for_acknowledgments(
                _connext().Duration.from_milliseconds(round(LAST_ACKNOWLEDGEMENT_S * 1000))
            )

    def close(self) -> None:
        self.wait_until_acknowledged()
        self.writer.close()


@dataclass(frozen=True, slots=True)
class _ConnextSubscription:
    withdraw: Callable[[], None]

    def close(self) -> None:
        self.withdraw()


def _connext() -> Any:
    """The package, imported at first use."""
    return import_module("rti.connextdds")


def _take_all(reader: Any, receive: Receive) -> None:
    """Hand on what is there, one by one: a time stamp must not wait for the next message's copy."""
    while True:
        with reader.select().max_samples(1).take_loaned() as samples:
            if not len(samples):
                return
            for sample in samples:
                info = sample.info
                if info.valid:
                    message = bytes(sample.data.get_cdr_buffer())
                    receive(
                        message, _nanoseconds(info.source_timestamp), _nanoseconds(info.reception_timestamp)
                    )


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * SECOND_NS + int(time.nanosec)


def _properties(options: NodeOptions) -> dict[str, str]:
    """Of the participant."""
    return {
        **(LOCALHOST_PROPERTIES if options.discovery is Discovery.LOCALHOST else {}),
        **(TUNED_PROPERTIES if options.tuned else {}),
    }


def _dynamic_type(dds: Any, type_name: str) -> Any:
    """The message type as Connext knows it."""
    package, kind, name = dds_name(type_name)
    made = dds.StructType(f"{package}::{kind}::dds_::{name}")
    for member, text in DDS_TYPES[type_name].items():
        made.add_member(dds.Member(member, _member_type(dds, text)))
    return made


def _member_type(dds: Any, text: str) -> Any:
    name, length = split_type(text)
    element = _dynamic_type(dds, name) if name in DDS_TYPES else getattr(dds, f"{name.capitalize()}Type")()
    if length is None:
        return element
    return dds.ArrayType(element, length) if length else dds.SequenceType(element)


def _fill(kept: Any, qos: Qos) -> Any:
    """`kept`, a writer's or reader's quality of service, with ours in it."""
    dds = _connext()
    reliabilities = {"reliable": dds.Reliability.reliable, "best_effort": dds.Reliability.best_effort}
    durabilities = {
        "volatile": lambda: dds.Durability.volatile,
        "transient_local": lambda: dds.Durability.transient_local,
    }
    histories = {
        "keep_last": lambda: dds.History.keep_last(qos.depth),
        "keep_all": lambda: dds.History.keep_all,
    }
    try:
        kept.reliability = _made(reliabilities[qos.reliability])
        kept.durability = _made(durabilities[qos.durability])
        kept.history = _made(histories[qos.history])
    except KeyError as err:
        raise OptionError(f"RTI Connext has no quality of service {err}") from err
    durations = {
        policy: dds.Duration(*divmod(asked, SECOND_NS)) for policy, asked in asked_durations(qos).items()
    }
    if "deadline" in durations:
        kept.deadline.period = durations["deadline"]
    if "lifespan" in durations:
        kept.lifespan.duration = durations["lifespan"]
    return kept


def _qos(found: Any) -> Qos:
    """Ours, of an endpoint that was discovered; what it does not tell is empty."""
    durations_ns = {"deadline": _nanoseconds(found.deadline.period)}
    if hasattr(found, "lifespan"):  # of a writer; of a reader it is nobody else's business
        durations_ns["lifespan"] = _nanoseconds(found.lifespan.duration)
    return Qos(
        _policy(found.reliability.kind), _policy(found.durability.kind), "", 0, duration_extra(durations_ns)
    )


def _made(value: Any) -> Any:
    """A policy, where Connext has some as values and some as functions that make one."""
    while callable(value):
        value = value()
    return value


def _policy(kind: Any) -> str:
    """`best_effort` of a kind that prints as `ReliabilityKind.BEST_EFFORT`."""
    return str(kind).rpartition(".")[2].lower()


def _ros_name(dds_type: str) -> str:
    """`sensor_msgs/msg/Image` of `sensor_msgs::msg::dds_::Image_`; any other name as it is."""
    found = re.fullmatch(r"(\w+)::(\w+)::dds_::(\w+)_", dds_type)
    return dds_type if found is None else "/".join(found.groups())
