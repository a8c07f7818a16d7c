"""`cyclonedds`: native Cyclone DDS through its Python package, with the topics and types of ROS 2.

Messages pass in serialized form: the package's serializer takes 32 ms for a megabyte. Only this file and `cyclone_settings` import
cyclonedds.
"""

# ruff: noqa: PLC0415 - loaded with a node: other backends run without it

from __future__ import annotations

import re
import threading
from contextlib import suppress
from ctypes import addressof, c_void_p
from functools import cache, partial
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.base.units import SECOND_NS

from ..choices import Security, Transport
from ..host.environment import ConfigurationVariable, MiddlewareEnvironment
from .base import Backend, Meeting, dds_meeting, has_package
from .cyclone_settings import (
    cyclone_qos,
    cyclone_settings,
    ignored_types,
    library_version,
    loaded_plugins,
    opaque_type,
    priority_of,
    qos_of,
    security_settings,
)
from .dds_types import DDS_TYPES, check_type, dds_name, dds_topic, ros_name, split_type
from .node import (
    LAST_ACKNOWLEDGEMENT_S,
    ROUND_S,
    Endpoint,
    Middleware,
    NodeSubscription,
    Publication,
    ThreadedNode,
    TopicView,
)
from .other_side import NOT_TEXT, Strangers, name_of_participant
from .qos import incompatible_pairs

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator, Mapping

    from dds_trace.tracefile.format.descriptions import Qos

    from .node import NodeOptions, Publisher, RawMessage, Receive, Subscription, TapReceive, TopicPatterns

MAX_ENDPOINTS = 10_000
MAX_TRIGGERS = 256  # most readers that one wait reports
TYPE_WAIT_NS = SECOND_NS
TYPE_CONSISTENCY = 24
"""DDS_TYPE_CONSISTENCY_ENFORCEMENT_QOS_POLICY_ID of `dds_public_qosdefs.h`."""

SUPPORTED = re.compile(r"(0\.10|11)\.")
"""Versions of the Python package that have the functions used here."""

_MAKING_TOPIC = threading.Lock()  # the package spoils a type if two threads make its first topics at once


class CycloneNode(ThreadedNode):
    def __init__(self, options: NodeOptions) -> None:
        from cyclonedds.core import DDSException, GuardCondition, WaitSet
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.qos import Policy
        from cyclonedds.qos import Qos as CycloneQos

        super().__init__(options)
        version = metadata.version("cyclonedds")
        if SUPPORTED.match(version) is None:
            raise BackendUnavailableError(
                f"cyclonedds {version} is not supported; install 11, or 0.10.2 for DDS Security"
            )
        settings = cyclone_settings(
            options.discovery, tuned=options.tuned, multicast=options.multicast, sizes=options.sizes, on_loopback=True
        )
        ignored = ignored_types(version)
        parts = (settings, ignored, security_settings(options))
        try:
            self._domain = _configured_domain(options.domain_id, ",".join(filter(None, parts)))
            qos = CycloneQos(Policy.EntityName(name_of_participant(options.name, options.security)))
            self._participant = DomainParticipant(options.domain_id, qos=qos)
        except DDSException as err:
            raise BackendUnavailableError(
                f"Cyclone DDS cannot join domain {options.domain_id} ({err}); see its messages on stderr "
                "and its settings in CYCLONEDDS_URI"
            ) from err
        self._waitset = WaitSet(self._participant)
        self._waitset.attach(GuardCondition(self._participant))  # never set: without a condition a wait returns at once
        self._builtin = _BuiltinReaders(self._participant, self.strangers)
        self._readers: dict[int, Any] = {}
        # Address by which the waitset reports a condition -> reader, callback, callback of a tap.
        self._triggers: dict[int | None, tuple[int, Receive[RawMessage] | None, Callable[..., None] | None]] = {}
        self._writers: list[_CyclonePublisher] = []
        self._middleware = Middleware(
            "cyclonedds",
            "cyclonedds",
            None,
            {"cyclonedds": version, **library_version()},
            {
                "discovery": options.discovery.value,
                "tuned": str(options.tuned).lower(),
                **({"CYCLONEDDS_URI": settings} if settings else {}),
                **({"type_information": "of Fast DDS ignored (IgnoreTypeInformation 1.15)"} if ignored else {}),
            },
        )

    def create_publisher(self, topic: str, type_name: str, *, qos: Qos | None = None) -> Publisher[RawMessage]:
        from cyclonedds.pub import DataWriter

        requested = cyclone_qos(qos or self.options.qos, self.options.priority)
        writer = DataWriter(self._participant, self._topic(topic, type_name), qos=requested)
        if self.options.priority is not None:
            self.publisher_settings = {"priority": str(priority_of(writer))}
        publisher = _CyclonePublisher(topic, writer)
        self._writers.append(publisher)
        return publisher

    def create_subscription(
        self, topic: str, type_name: str, receive: Receive[RawMessage], *, qos: Qos | None = None
    ) -> Subscription:
        return self._open_reader(self._topic(topic, type_name), qos or self.options.qos, receive, None)

    def _open_reader(
        self, topic: Any, qos: Qos, receive: Receive[RawMessage] | None, tap: Callable[..., None] | None
    ) -> Subscription:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader

        reader = DataReader(self._participant, topic, qos=cyclone_qos(qos))
        condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        self._waitset.attach(condition)
        self._readers = {**self._readers, reader._ref: condition}  # noqa: SLF001 - see `_take`
        _, trigger = self._waitset.attached[-1]
        self._triggers = {**self._triggers, addressof(trigger): (reader._ref, receive, tap)}  # noqa: SLF001
        return NodeSubscription(partial(self._withdraw, reader))

    def list_publications(self, matches: TopicPatterns) -> list[Publication]:
        return self._builtin.publications(matches, self.options.name)

    def create_tap(self, topic: str, type_name: str, receive: TapReceive, *, qos: Qos) -> Subscription:
        from cyclonedds.topic import Topic

        is_of_type: dict[int, bool] = {}

        # A writer with a type of another name and the same members matches as well.
        def on_sample(message: RawMessage, info: Any) -> None:
            handle = info.publication_handle
            if handle not in is_of_type:
                is_of_type[handle] = self._builtin.type_of(handle) in (type_name, None)
            if is_of_type[handle]:
                receive(message, info.source_timestamp, 0, 0, handle)

        data_type = self._builtin.definition_of(topic, type_name, self._participant) or opaque_type(type_name)
        with _MAKING_TOPIC:
            tapped = Topic(self._participant, f"rt{topic}" if topic.startswith("/") else topic, data_type)
        return self._open_reader(tapped, qos, None, on_sample)

    def publisher_of(self, source: Hashable) -> str | None:
        return self._builtin.key_of(source)

    def members(self, type_name: str) -> Mapping[str, str] | None:
        return DDS_TYPES.get(type_name)

    def _topic(self, topic: str, type_name: str) -> Any:
        from cyclonedds.topic import Topic

        with _MAKING_TOPIC:
            return Topic(self._participant, dds_topic(topic), _message_type(type_name))

    def _withdraw(self, reader: Any) -> None:
        readers = dict(self._readers)
        condition = readers.pop(reader._ref, None)  # noqa: SLF001 - see `_take`
        if condition is not None:
            self._readers = readers
            self._triggers = {address: target for address, target in self._triggers.items() if target[0] in readers}
            self._waitset.detach(condition)
            _delete(condition)
            _delete(reader)

    def _make_round(self) -> Callable[[], None]:
        # Not a listener: on the thread that receives acknowledgements, a relay's write that waits for one would wait
        # for itself.
        from cyclonedds.core import DDSException

        # Not WaitSet.wait: its Python layers take 8 % of a round trip at 100 Hz, and it does not report which reader
        # has a message.
        waitset, patience_ns = self._waitset, round(ROUND_S * SECOND_NS)
        addresses = (c_void_p * MAX_TRIGGERS)()
        library, handle = waitset._dll_handle, waitset._ref  # noqa: SLF001
        wait = partial(library.dds_waitset_wait, handle, addresses, MAX_TRIGGERS, patience_ns)
        take = _take()

        def receive_round() -> None:
            triggered = wait()
            if triggered < 0:
                raise DDSException(triggered, "while waiting for a message")
            for address in addresses[:triggered]:
                reader, receive, tap = self._triggers.get(address, (0, None, None))
                if receive is not None:  # not closed meanwhile
                    for data, info in take(reader):  # further messages trigger again
                        if info.valid_data:
                            receive(data, info.source_timestamp)
                elif tap is not None:
                    for data, info in take(reader):
                        if info.valid_data:
                            tap(data, info)

        return receive_round

    def look_at(self, topic: str) -> TopicView:
        publishers = tuple(self._builtin.endpoints("publications", dds_topic(topic)))
        subscriptions = tuple(self._builtin.endpoints("subscriptions", dds_topic(topic)))
        pairs = incompatible_pairs(topic, publishers, subscriptions, self.options.name)
        return TopicView(topic, publishers, subscriptions, tuple(pairs), tuple(sorted(self._unassignable(topic))))

    def _unassignable(self, topic: str) -> set[str]:
        from cyclonedds.core import DDSException

        if _is_old():  # it has no such status
            return set()
        statuses = [
            (publisher.writer.get_offered_incompatible_qos_status, "subscription's")
            for publisher in self._writers
            if publisher.topic == topic
        ] + [
            (condition.reader.get_requested_incompatible_qos_status, "publisher's")
            for condition in self._readers.values()
            if condition.reader.topic.name == dds_topic(topic)
        ]
        lines = set()
        for read_status, others in statuses:
            with suppress(DDSException):  # the endpoint was closed
                if read_status().last_policy_id == TYPE_CONSISTENCY:
                    lines.add(f"{topic}: a {others} type has the same name and another definition")
        return lines

    def read_security(self) -> str:
        return loaded_plugins() if self.options.keys is not None else ""

    def participant_names(self) -> list[str]:
        return sorted(self._builtin.participants().values())

    def _leave(self) -> None:
        for writer in self._writers:
            writer.wait_until_acknowledged()
        _delete(self._participant)  # with its endpoints
        if self._domain is not None:
            _delete(self._domain)


class _CyclonePublisher:
    def __init__(self, topic: str, writer: Any) -> None:
        self.topic = topic
        self.writer = writer
        # DataWriter.write would serialize an object
        self._write = partial(_c_layer().ddspy_write, writer._ref)  # noqa: SLF001

    def publish(self, message: RawMessage, /) -> None:
        if len(message) % 4:  # Cyclone DDS takes whole words
            message = message.ljust(-(-len(message) // 4) * 4, b"\0")
        status = self._write(message)
        if status < 0:
            raise BackendUnavailableError(
                f"Cyclone DDS cannot send on {self.topic} (status {status}, {len(message)} bytes)"
            )

    def wait_until_acknowledged(self) -> None:
        with suppress(Exception):  # it is closed
            self.writer.wait_for_acks(round(LAST_ACKNOWLEDGEMENT_S * SECOND_NS))

    def close(self) -> None:
        self.wait_until_acknowledged()
        _delete(self.writer)


class _BuiltinReaders:
    def __init__(self, participant: Any, strangers: Strangers) -> None:
        from cyclonedds import builtin
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState

        topics = {
            "participants": builtin.BuiltinTopicDcpsParticipant,
            "publications": builtin.BuiltinTopicDcpsPublication,
            "subscriptions": builtin.BuiltinTopicDcpsSubscription,
        }
        self._strangers = strangers
        self._open: Callable[[str], Any] = lambda name: builtin.BuiltinDataReader(participant, topics[name])
        self._readers = {name: self._open(name) for name in topics}
        present = SampleState.Any | ViewState.Any | InstanceState.Alive
        self._present = {name: ReadCondition(reader, present) for name, reader in self._readers.items()}

    def _read(self, name: str) -> list[Any]:
        try:
            samples = self._readers[name].read(MAX_ENDPOINTS, self._present[name])
        except Exception:  # noqa: BLE001 - its C layer raises this one for a name that is not text
            self._strangers.count_once(NOT_TEXT)
            samples = self._read_singly(name)
        return [sample for sample in samples if sample.sample_info.valid_data]

    def _read_singly(self, name: str) -> list[Any]:
        reader, samples = self._open(name), list[Any]()
        for _ in range(MAX_ENDPOINTS):
            with suppress(Exception):
                sample = reader.take(1)
                if not sample:
                    break
                samples += sample
        _delete(reader)
        return samples

    def participants(self) -> dict[Any, str]:
        from cyclonedds.qos import Policy

        return {
            data.key: data.qos[Policy.EntityName].name if Policy.EntityName in data.qos else ""
            for data in self._read("participants")
        }

    def endpoints(self, kind: str, topic: str) -> list[Endpoint]:
        names = self.participants()
        return [
            Endpoint(names.get(endpoint.participant_key, ""), ros_name(endpoint.type_name), qos_of(endpoint.qos))
            for endpoint in self._read(kind)
            if endpoint.topic_name == topic
        ]

    def publications(self, matches: TopicPatterns, own_name: str) -> list[Publication]:
        names = self.participants()
        return [
            Publication(
                topic, ros_name(data.type_name), data.key.hex, names.get(data.participant_key, ""), qos_of(data.qos)
            )
            for data in self._read("publications")
            if matches(topic := _shown_topic(data.topic_name)) and names.get(data.participant_key) != own_name
        ]

    def key_of(self, handle: Hashable) -> str | None:
        return next((data.key.hex for data in self._written_by(handle)), None)

    def type_of(self, handle: Hashable) -> str | None:
        return next((ros_name(data.type_name) for data in self._written_by(handle)), None)

    def _written_by(self, handle: Hashable) -> Iterator[Any]:
        return (data for data in self._read("publications") if data.sample_info.instance_handle == handle)

    def definition_of(self, topic: str, type_name: str, participant: Any) -> Any:
        from cyclonedds.dynamic import get_types_for_typeid

        for data in self._read("publications"):
            if (_shown_topic(data.topic_name), ros_name(data.type_name)) == (topic, type_name) and data.type_id:
                with suppress(Exception):  # whatever a peer describes: its messages are then of an opaque type
                    return get_types_for_typeid(participant, data.type_id, TYPE_WAIT_NS)[0]
        return None


def _shown_topic(name: str) -> str:
    return name.removeprefix("rt") if name.startswith("rt/") else name


def _configured_domain(domain_id: int, settings: str) -> Any:
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain

    try:
        return Domain(domain_id, settings)
    except DDSException as err:
        if err.code == DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
            return None
        raise


def _is_old() -> bool:
    return metadata.version("cyclonedds").startswith("0.10.")


def _c_layer() -> Any:
    return import_module("cyclonedds._clayer")


def _take() -> Callable[[int], list[tuple[bytes, Any]]]:
    from cyclonedds.core import DDSException, InstanceState, SampleState, ViewState

    ddspy_take = _c_layer().ddspy_take
    everything = SampleState.Any | ViewState.Any | InstanceState.Any
    selected = () if _is_old() else (everything,)

    def take(reader: int) -> list[tuple[bytes, Any]]:
        # One at a time: a time stamp must not wait for the next copy. Not DataReader.take, which deserializes.
        samples = ddspy_take(reader, *selected, 1)
        if isinstance(samples, int):
            if samples == DDSException.DDS_RETCODE_ALREADY_DELETED:
                return []
            raise DDSException(samples, "while taking a message")
        return list(samples)

    return take


@cache
def _message_type(type_name: str) -> Any:
    from cyclonedds.idl import make_idl_struct

    check_type("cyclonedds", type_name)
    name = dds_name(type_name).replace("::", ".")
    members = {member: _member_type(text) for member, text in DDS_TYPES[type_name].items()}
    return make_idl_struct(name.rpartition(".")[2], name, members)


def _member_type(text: str) -> Any:
    idl: Any = import_module("cyclonedds.idl.types")
    name, length = split_type(text)
    plain = {"string": str, "bool": bool}
    element = _message_type(name) if name in DDS_TYPES else plain.get(name) or getattr(idl, name)
    if length is None:
        return element
    return idl.array[element, length] if length else idl.sequence[element]


def _delete(entity: Any) -> None:
    entity.__del__()


BACKEND = Backend(
    name="cyclonedds",
    label="Cyclone DDS",
    make_node=CycloneNode,
    find_installed=lambda: [None] if has_package("cyclonedds") else [],
    install=(
        "pip install 'dds-trace[cyclonedds]' (in a clone '.[cyclonedds]') (wheels for x86_64), or build the package `cyclonedds` on this device"
    ),
    meeting=Meeting.DISCOVERY,
    meeting_needs=dds_meeting("else list peers in CYCLONEDDS_URI"),
    speaks_dds=True,
    security=tuple(level for level in Security if level is not Security.OFF),
    priorities=range(-(1 << 31), 1 << 31),
    can_multicast=True,
    sizes={Transport.DEFAULT: ("buffer", "fragment")},
    environment=MiddlewareEnvironment(configuration=(ConfigurationVariable("CYCLONEDDS_URI", ","),)),
    variables_of=lambda _, path: {"CYCLONEDDS_URI": path.as_uri()},
)
