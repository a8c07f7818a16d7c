"""`connext`: RTI Connext, in a DynamicData of CDR (docs/reference/middlewares.md). Only this file imports rti.connextdds."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from typing import Any

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Qos

from ..choices import Discovery, Durability, History, Reliability
from ..host.environment import ConfigurationVariable, MiddlewareEnvironment
from .base import Backend, Meeting, dds_meeting, has_package
from .dds_types import DDS_TYPES, check_type, dds_name, dds_topic, ros_name, split_type
from .node import (
    LAST_ACKNOWLEDGEMENT_S,
    ROUND_S,
    Endpoint,
    Middleware,
    NodeOptions,
    NodeSubscription,
    Publisher,
    RawMessage,
    Receive,
    Subscription,
    ThreadedNode,
    TopicView,
)
from .qos import duration_extra, incompatible_pairs, requested_durations

TUNED_PROPERTIES = {"dds.transport.UDPv4.builtin.recv_socket_buffer_size": "4000000"}
LOCALHOST_PROPERTIES = {"dds.transport.UDPv4.builtin.parent.allow_interfaces_list": "127.0.0.1"}
LOCALHOST_PEERS = ("builtin.udpv4://127.0.0.1", "builtin.shmem://")


class ConnextNode(ThreadedNode):
    def __init__(self, options: NodeOptions) -> None:
        dds = _connext()
        super().__init__(options)
        qos = dds.DomainParticipantQos()
        qos.participant_name.name = options.name
        properties = {
            **(LOCALHOST_PROPERTIES if options.discovery is Discovery.LOCALHOST else {}),
            **(TUNED_PROPERTIES if options.tuned else {}),
        }
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
                f"your rti_license.dat (RTI's own reason is in the line above; {err})"
            ) from err
        self._waitset = dds.WaitSet()
        self._readers: tuple[tuple[Any, Receive[RawMessage]], ...] = ()
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

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RawMessage]:
        dds = _connext()
        dds_topic_object, dynamic_type = self._topic(topic, type_name)
        policies = _fill(dds.DataWriterQos(), qos or self.options.qos)
        # Reliable messages of several datagrams need a thread of Connext's ("large data" in its manual).
        policies.publish_mode = dds.PublishMode.asynchronous()
        writer = dds.DynamicData.DataWriter(dds.Publisher(self._participant), dds_topic_object, policies)
        publisher = _ConnextPublisher(writer, dds.DynamicData(dynamic_type))
        self._writers.append(publisher)
        return publisher

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        dds = _connext()
        dds_topic_object, _ = self._topic(topic, type_name)
        policies = _fill(dds.DataReaderQos(), qos or self.options.qos)
        reader = dds.DynamicData.DataReader(dds.Subscriber(self._participant), dds_topic_object, policies)
        condition = dds.StatusCondition(reader)
        condition.enabled_statuses = dds.StatusMask.DATA_AVAILABLE
        self._waitset += condition
        self._readers += ((reader, receive),)
        return NodeSubscription(partial(self._withdraw, reader, condition))

    def _topic(self, topic: str, type_name: str) -> tuple[Any, Any]:
        dds = _connext()
        check_type("connext", type_name)
        dynamic_type = _dynamic_type(dds, type_name)
        name = dds_name(type_name)
        topic_object = dds.DynamicData.Topic.find(self._participant, dds_topic(topic))
        if topic_object is None:
            if not self._participant.is_type_registered(name):
                serialized = dds.DynamicDataTypeSerializationProperty()
                serialized.skip_deserialization = True
                self._participant.register_type(name, dynamic_type, serialized)
            topic_object = dds.DynamicData.Topic(self._participant, dds_topic(topic), name, dds.TopicQos())
        return topic_object, dynamic_type

    def _withdraw(self, reader: Any, condition: Any) -> None:
        if any(other is reader for other, _ in self._readers):
            self._readers = tuple(pair for pair in self._readers if pair[0] is not reader)
            self._waitset -= condition
            reader.close()

    def _make_round(self) -> Callable[[], None]:
        timeout_error, wait = _connext().TimeoutError, self._waitset.wait
        patience = _connext().Duration.from_milliseconds(round(ROUND_S * 1000))

        def receive_round() -> None:
            with suppress(timeout_error):
                wait(patience)
            for reader, receive in self._readers:
                _take_all(reader, receive)

        return receive_round

    def look_at(self, topic: str) -> TopicView:
        qos = self.options.qos  # Connext does not report own endpoints
        reported = Qos(qos.reliability, qos.durability, "", 0, qos.extra)
        publishers = self._endpoints(self._participant.publication_reader, topic)
        subscriptions = self._endpoints(self._participant.subscription_reader, topic)
        publishers += [
            Endpoint(self.options.name, ros_name(writer.writer.type_name), reported)
            for writer in self._writers
            if not writer.writer.closed and writer.writer.topic_name == dds_topic(topic)
        ]
        subscriptions += [
            Endpoint(self.options.name, ros_name(reader.type_name), reported)
            for reader, _ in self._readers
            if reader.topic_name == dds_topic(topic)
        ]
        pairs = incompatible_pairs(topic, publishers, subscriptions, self.options.name)
        return TopicView(topic, tuple(publishers), tuple(subscriptions), tuple(pairs))

    def _endpoints(self, reader: Any, topic: str) -> list[Endpoint]:
        participants = map(self._participant.discovered_participant_data, self._participant.discovered_participants())
        names = {str(data.key): data.participant_name.name or "" for data in participants}
        return [
            Endpoint(names.get(str(endpoint.participant_key), ""), ros_name(endpoint.type_name), _qos(endpoint))
            for endpoint in reader.read_data()
            if endpoint.topic_name == dds_topic(topic)
        ]

    def count_participants(self) -> int | None:
        return 1 + len(self._participant.discovered_participants())

    def _leave(self) -> None:
        for writer in self._writers:
            writer.wait_until_acknowledged()
        self._participant.close()


@dataclass(frozen=True, slots=True)
class _ConnextPublisher:
    writer: Any
    sample: Any

    def publish(self, message: RawMessage, /) -> None:
        self.sample.set_cdr_buffer(message)
        self.writer.write(self.sample)

    def wait_until_acknowledged(self) -> None:
        with suppress(Exception):  # it is closed
            self.writer.wait_for_acknowledgments(
                _connext().Duration.from_milliseconds(round(LAST_ACKNOWLEDGEMENT_S * 1000))
            )

    def close(self) -> None:
        self.wait_until_acknowledged()
        self.writer.close()


def _connext() -> Any:
    return import_module("rti.connextdds")


def _take_all(reader: Any, receive: Receive[RawMessage]) -> None:
    """Deliver messages one by one: a time stamp must not wait for the next copy."""
    while True:
        with reader.select().max_samples(1).take_loaned() as samples:
            if not len(samples):
                return
            for sample in samples:
                info = sample.info
                if info.valid:
                    message = bytes(sample.data.get_cdr_buffer())
                    receive(message, _nanoseconds(info.source_timestamp), _nanoseconds(info.reception_timestamp))


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * SECOND_NS + int(time.nanosec)


def _dynamic_type(dds: Any, type_name: str) -> Any:
    struct = dds.StructType(dds_name(type_name))
    for member, text in DDS_TYPES[type_name].items():
        struct.add_member(dds.Member(member, _member_type(dds, text)))
    return struct


def _member_type(dds: Any, text: str) -> Any:
    name, length = split_type(text)
    element = _dynamic_type(dds, name) if name in DDS_TYPES else getattr(dds, f"{name.capitalize()}Type")()
    if length is None:
        return element
    return dds.ArrayType(element, length) if length else dds.SequenceType(element)


def _fill(policies: Any, qos: Qos) -> Any:
    dds = _connext()
    values = {
        Reliability.RELIABLE: dds.Reliability.reliable,
        Reliability.BEST_EFFORT: dds.Reliability.best_effort,
        Durability.VOLATILE: dds.Durability.volatile,
        Durability.TRANSIENT_LOCAL: dds.Durability.transient_local,
        History.KEEP_LAST: partial(dds.History.keep_last, qos.depth),
        History.KEEP_ALL: dds.History.keep_all,
    }
    try:
        for policy in ("reliability", "durability", "history"):
            value = values[getattr(qos, policy)]
            # Some of Connext's values are functions that make one.
            setattr(policies, policy, value() if callable(value) else value)
    except KeyError as err:
        raise OptionError(f"RTI Connext has no quality of service {err}") from err
    durations = {
        policy: dds.Duration(*divmod(duration_ns, SECOND_NS))
        for policy, duration_ns in requested_durations(qos).items()
    }
    if "deadline" in durations:
        policies.deadline.period = durations["deadline"]
    if "lifespan" in durations:
        policies.lifespan.duration = durations["lifespan"]
    return policies


def _qos(endpoint: Any) -> Qos:
    durations_ns = {"deadline": _nanoseconds(endpoint.deadline.period)}
    if hasattr(endpoint, "lifespan"):  # only a writer reports it
        durations_ns["lifespan"] = _nanoseconds(endpoint.lifespan.duration)
    return Qos(
        _policy(endpoint.reliability.kind), _policy(endpoint.durability.kind), "", 0, duration_extra(durations_ns)
    )


def _policy(kind: Any) -> str:
    return str(kind).rpartition(".")[2].lower()


BACKEND = Backend(
    name="connext",
    label="RTI Connext",
    make_node=ConnextNode,
    # no licence, no participant
    find_installed=lambda: [None] if has_package("rti") and os.environ.get("RTI_LICENSE_FILE") else [],
    install="pip install 'dds-trace[connext]' (in a clone '.[connext]'), then set RTI_LICENSE_FILE to your rti_license.dat",
    meeting=Meeting.DISCOVERY_OR_PEERS,
    meeting_needs=dds_meeting("else name the other device with --peer"),
    speaks_dds=True,
    environment=MiddlewareEnvironment(
        configuration=(ConfigurationVariable("NDDS_QOS_PROFILES", ";"),), files=("USER_QOS_PROFILES.xml",)
    ),
)
