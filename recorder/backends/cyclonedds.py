"""`cyclonedds`: native Cyclone DDS through its Python package, with the topics and types of ROS 2.

It talks to ROS 2 nodes of any DDS vendor: topic `NAME` is `rt/NAME` in DDS, type `sensor_msgs/msg/Image` is
`sensor_msgs::msg::dds_::Image_`. Messages pass as they are serialized; the package's own serializer in Python would
take 32 ms for a megabyte. The only file that imports cyclonedds.
"""

# ruff: noqa: PLC0415 - Cyclone DDS is loaded when a node is opened, so that other backends run without it

from __future__ import annotations

import re
from contextlib import suppress
from ctypes import addressof, c_void_p
from functools import cache, partial
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Qos

from ..host.environment import ConfigurationVariable, MiddlewareEnvironment
from .base import DDS_MEETING, Backend, Meeting
from .cyclone_settings import cyclone_loopback, cyclone_settings
from .dds_types import DDS_TYPES, check_known, dds_name, dds_topic, ros_name, split_type
from .node import Endpoint, Middleware, TopicView
from .qos import duration_extra, incompatible_pairs, requested_durations
from .threaded import LAST_ACKNOWLEDGEMENT_S, ROUND_S, NodeSubscription, ThreadedNode, has_package

if TYPE_CHECKING:
    from collections.abc import Callable

    from .node import NodeOptions, Publisher, RawMessage, Receive, Subscription

FOREVER_NS = (1 << 63) - 1
MAX_ENDPOINTS = 10_000
MAX_TOLD = 256
"""Readers of which one wait of the waitset tells; others that have something as well trigger the next one."""
TYPE_CONSISTENCY = 24
"""DDS_TYPE_CONSISTENCY_ENFORCEMENT_QOS_POLICY_ID of Cyclone DDS's `dds_public_qosdefs.h`."""


class CycloneNode(ThreadedNode):
    """One participant with its readers' thread; see `Node` for the names."""

    def __init__(self, options: NodeOptions) -> None:
        from cyclonedds.core import DDSException, WaitSet
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.qos import Policy
        from cyclonedds.qos import Qos as CycloneQos

        super().__init__(options)
        localhost = cyclone_loopback(options.discovery)
        ours = cyclone_settings(options.discovery, tuned=options.tuned)
        settings = ",".join(filter(None, (localhost, ours)))
        try:
            self._domain = _configured_domain(options.domain_id, settings)
            self._participant = DomainParticipant(
                options.domain_id, qos=CycloneQos(Policy.EntityName(options.name))
            )
        except DDSException as err:
            raise BackendUnavailableError(
                f"Cyclone DDS cannot join domain {options.domain_id} ({err}); its reasons are on stderr, "
                "its settings in CYCLONEDDS_URI"
            ) from err
        self._waitset = WaitSet(self._participant)
        self._builtin = _BuiltinReaders(self._participant)
        self._readers: dict[int, tuple[Any, Receive[RawMessage]]] = {}
        # What the waitset tells of a condition -> its reader and callback.
        self._triggers: dict[int | None, tuple[int, Receive[RawMessage]]] = {}
        self._writers: list[_CyclonePublisher] = []
        self._middleware = Middleware(
            "cyclonedds",
            "cyclonedds",
            None,
            {"cyclonedds": metadata.version("cyclonedds"), **_library_version()},
            {
                "discovery": options.discovery.value,
                "tuned": str(options.tuned).lower(),
                **({"CYCLONEDDS_URI": settings} if settings else {}),
            },
        )

    def create_publisher(
        self, topic: str, type_name: str, *, qos: Qos | None = None
    ) -> Publisher[RawMessage]:
        """Create a writer of bytes."""
        from cyclonedds.pub import DataWriter

        writer = DataWriter(
            self._participant, self._topic(topic, type_name), qos=_cyclone_qos(qos or self._options.qos)
        )
        publisher = _CyclonePublisher(topic, writer)
        self._writers.append(publisher)
        return publisher

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        """Create a reader of bytes."""
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader

        reader = DataReader(
            self._participant, self._topic(topic, type_name), qos=_cyclone_qos(qos or self._options.qos)
        )
        condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        self._waitset.attach(condition)
        self._readers = {**self._readers, reader._ref: (condition, receive)}  # noqa: SLF001 - see `_take`
        _, told = self._waitset.attached[-1]  # a C integer, whose address the waitset gives back
        self._triggers = {**self._triggers, addressof(told): (reader._ref, receive)}  # noqa: SLF001
        return NodeSubscription(partial(self._withdraw, reader))

    def _topic(self, topic: str, type_name: str) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self._participant, dds_topic(topic), _type_called(type_name))

    def _withdraw(self, reader: Any) -> None:
        readers = dict(self._readers)
        condition, _ = readers.pop(reader._ref, (None, None))  # noqa: SLF001 - see `_take`
        if condition is not None:
            self._readers = readers
            self._triggers = {at: found for at, found in self._triggers.items() if found[0] in readers}
            self._waitset.detach(condition)
            _delete(condition)
            _delete(reader)

    def _make_round(self) -> Callable[[], None]:
        # A listener would call from the thread that receives for all of Cyclone DDS, acknowledgements included: a
        # relay's write that waits for one would wait for itself.
        from cyclonedds.core import DDSException

        # WaitSet.wait calls this through two functions of Python, which took 8 % of a round trip at 100 Hz (median of three
        # pairs of runs), when caches are cold; and it does not tell which reader has something: to look at one that has
        # nothing takes 20 us then.
        waitset, patience_ns = self._waitset, round(ROUND_S * SECOND_NS)
        told = (c_void_p * MAX_TOLD)()
        wait = partial(waitset._dll_handle.dds_waitset_wait, waitset._ref, told, MAX_TOLD, patience_ns)  # noqa: SLF001
        take = _take()

        def receive_round() -> None:
            triggered = wait()
            if triggered < 0:
                raise DDSException(triggered, "while waiting for a message")
            for at in told[:triggered]:
                reader, receive = self._triggers.get(at, (0, None))
                if receive is not None:  # and not withdrawn a moment ago
                    for data, info in take(reader):  # what else it has triggers again
                        if info.valid_data:
                            receive(data, info.source_timestamp)

        return receive_round

    def look_at(self, topic: str) -> TopicView:
        """Return the endpoints that Cyclone DDS has discovered; they do not carry the name of a ROS 2 node."""
        names = {key: name for key, name in self._builtin.participants().items() if name}
        publishers = tuple(self._builtin.endpoints("publications", dds_topic(topic), names))
        subscriptions = tuple(self._builtin.endpoints("subscriptions", dds_topic(topic), names))
        named = incompatible_pairs(topic, publishers, subscriptions, self._options.name)
        return TopicView(
            topic, publishers, subscriptions, tuple(named), tuple(sorted(self._unassignable(topic)))
        )

    def _unassignable(self, topic: str) -> set[str]:
        """Return a line for each way on a topic on which Cyclone DDS met an endpoint of a type that it cannot assign.

        It counts such an endpoint as one of incompatible quality of service, by the policy for the consistency of types.
        """
        from cyclonedds.core import DDSException

        statuses = [
            (writer.get_offered_incompatible_qos_status, "subscription's")
            for writer in (publisher.writer for publisher in self._writers if publisher.topic == topic)
        ] + [
            (condition.reader.get_requested_incompatible_qos_status, "publisher's")
            for condition, _ in self._readers.values()
            if condition.reader.topic.name == dds_topic(topic)
        ]
        lines = set()
        for read_status, others in statuses:
            with suppress(DDSException):  # closed meanwhile
                if read_status().last_policy_id == TYPE_CONSISTENCY:
                    lines.add(f"{topic}: a {others} type has the same name and another definition")
        return lines

    def count_participants(self) -> int | None:
        """Count the participants of the domain."""
        return len(self._builtin.participants())

    def _leave(self) -> None:
        for writer in self._writers:
            writer.wait_until_acknowledged()
        _delete(self._participant)  # and all that it made
        if self._domain is not None:
            _delete(self._domain)


class _CyclonePublisher:
    """A publisher of serialized messages."""

    def __init__(self, topic: str, writer: Any) -> None:
        self.topic = topic
        self.writer = writer
        # DataWriter.write would serialize an object
        self._write = partial(_c_layer().ddspy_write, writer._ref)  # noqa: SLF001

    def publish(self, message: RawMessage, /) -> None:
        if len(message) % 4:  # Cyclone DDS takes whole words; a copy, but of a message that is seldom large
            message = message.ljust(-(-len(message) // 4) * 4, b"\0")
        status = self._write(message)
        if status < 0:
            raise BackendUnavailableError(
                f"Cyclone DDS cannot send on {self.topic} (status {status}, {len(message)} bytes)"
            )

    def wait_until_acknowledged(self) -> None:
        """Wait until the last messages have arrived, for `LAST_ACKNOWLEDGEMENT_S` at most."""
        with suppress(Exception):  # closed before: nothing to wait for
            self.writer.wait_for_acks(round(LAST_ACKNOWLEDGEMENT_S * SECOND_NS))

    def close(self) -> None:
        self.wait_until_acknowledged()
        _delete(self.writer)


class _BuiltinReaders:
    """The readers of DDS's own topics, which hold the participants and endpoints discovered so far."""

    def __init__(self, participant: Any) -> None:
        from cyclonedds import builtin
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState

        self._readers = {
            "participants": builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsParticipant),
            "publications": builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsPublication),
            "subscriptions": builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsSubscription),
        }
        present = SampleState.Any | ViewState.Any | InstanceState.Alive
        self._present = {name: ReadCondition(reader, present) for name, reader in self._readers.items()}

    def _read(self, name: str) -> list[Any]:
        samples = self._readers[name].read(MAX_ENDPOINTS, self._present[name])
        return [sample for sample in samples if sample.sample_info.valid_data]

    def participants(self) -> dict[Any, str]:
        """Return key -> name of each participant; the name is empty if it has none."""
        from cyclonedds.qos import Policy

        return {
            found.key: found.qos[Policy.EntityName].name if Policy.EntityName in found.qos else ""
            for found in self._read("participants")
        }

    def endpoints(self, kind: str, topic: str, names: dict[Any, str]) -> list[Endpoint]:
        """Return the writers (`publications`) or readers (`subscriptions`) of a topic of DDS."""
        return [
            Endpoint(
                names.get(endpoint.participant_key, ""), ros_name(endpoint.type_name), _qos(endpoint.qos)
            )
            for endpoint in self._read(kind)
            if endpoint.topic_name == topic
        ]


def _configured_domain(domain_id: int, settings: str) -> Any:
    """Open the domain with our settings; return None if another node of this process has set it up already."""
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain

    try:
        return Domain(domain_id, settings)
    except DDSException as err:
        if err.code == DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
            return None
        raise


def _c_layer() -> Any:
    """Return the compiled part of the package, which takes messages as bytes."""
    return import_module("cyclonedds._clayer")


def _take() -> Callable[[int], list[tuple[bytes, Any]]]:
    """Return a function that takes a reader's next message, as its bytes and its DDS sample information, if there is one."""
    from cyclonedds.core import DDSException, InstanceState, SampleState, ViewState

    ddspy_take = _c_layer().ddspy_take
    everything = SampleState.Any | ViewState.Any | InstanceState.Any

    def take(reader: int) -> list[tuple[bytes, Any]]:
        # One at a time: the time stamp of a message must not wait for the next one's copy. DataReader.take would
        # make an object of it.
        samples = ddspy_take(reader, everything, 1)
        if isinstance(samples, int):
            if samples == DDSException.DDS_RETCODE_ALREADY_DELETED:
                return []
            raise DDSException(samples, "while taking a message")
        return list(samples)

    return take


@cache
def _type_called(type_name: str) -> Any:
    """Return the message type for Cyclone DDS, which checks each serialized message against it.

    Raises:
        OptionError: the type is not known here.
    """
    from cyclonedds.idl import make_idl_struct

    check_known("cyclonedds", type_name)
    package, kind, name = dds_name(type_name)
    members = {member: _member_type(text) for member, text in DDS_TYPES[type_name].items()}
    return make_idl_struct(name, f"{package}.{kind}.dds_.{name}", members)


def _member_type(text: str) -> Any:
    idl: Any = import_module("cyclonedds.idl.types")  # its annotations hide that the types take parameters
    name, length = split_type(text)
    plain = {"string": str, "bool": bool}
    element = _type_called(name) if name in DDS_TYPES else plain.get(name) or getattr(idl, name)
    if length is None:
        return element
    return idl.array[element, length] if length else idl.sequence[element]


def _cyclone_qos(qos: Qos) -> Any:
    from cyclonedds.qos import Policy
    from cyclonedds.qos import Qos as CycloneQos

    reliabilities = {
        # As ROS 2 has it: a writer that must wait for a slow reader waits, and drops nothing behind one's back.
        "reliable": Policy.Reliability.Reliable(max_blocking_time=FOREVER_NS),
        "best_effort": Policy.Reliability.BestEffort,
    }
    durabilities = {
        "volatile": Policy.Durability.Volatile,
        "transient_local": Policy.Durability.TransientLocal,
    }
    histories = {"keep_last": Policy.History.KeepLast(qos.depth), "keep_all": Policy.History.KeepAll}
    try:
        history = histories[qos.history]
        policies = [reliabilities[qos.reliability], durabilities[qos.durability], history]
    except KeyError as err:
        raise OptionError(f"Cyclone DDS has no quality of service {err}") from err
    durations = {"deadline": Policy.Deadline, "lifespan": Policy.Lifespan}
    policies += [durations[policy](duration_ns) for policy, duration_ns in requested_durations(qos).items()]
    if qos.durability == "transient_local":  # what is kept for late readers, as much as ROS 2 keeps
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    return CycloneQos(*policies)


def _qos(policies: Any) -> Qos:
    """Return the quality of service of a discovered endpoint; policies that it does not report are empty."""
    from cyclonedds.qos import Policy

    reliability, durability = (
        re.sub(r"(?<=[a-z])(?=[A-Z])", "_", type(policies[policy]).__name__.rpartition(".")[2]).lower()
        if policy in policies
        else ""
        for policy in (Policy.Reliability, Policy.Durability)
    )
    durations_ns = {
        policy.__scope__.lower(): getattr(policies[policy], policy.__scope__.lower())
        for policy in (Policy.Deadline, Policy.Lifespan)
        if policy in policies
    }
    return Qos(reliability, durability, "", 0, duration_extra(durations_ns))


def _delete(entity: Any) -> None:
    entity.__del__()  # dds_delete; the package has no other word for it


def _library_version() -> dict[str, str]:
    """Return the version of the library that is loaded, from its file name."""
    with suppress(OSError):
        if version := re.search(r"libddsc\S*\.so\.([\d.]+)", Path("/proc/self/maps").read_text()):
            return {"libddsc": version[1]}
    return {}


BACKEND = Backend(
    name="cyclonedds",
    label="Cyclone DDS",
    make_node=CycloneNode,
    find_installed=lambda: [None] if has_package("cyclonedds") else [],
    install=(
        "pip install 'dds-trace[cyclonedds]' (wheels for x86_64), or build the package `cyclonedds` on this device"
    ),
    meeting=Meeting.DISCOVERY,
    meeting_needs=DDS_MEETING + " (else list peers in CYCLONEDDS_URI)",
    speaks_dds=True,
    environment=MiddlewareEnvironment(configuration=(ConfigurationVariable("CYCLONEDDS_URI", ","),)),
)
