"""`routing-service`: RTI's Routing Service, the paper's choice for Connext."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.units import SECOND_NS

from ..backends.dds_types import DDS_TYPES, dds_name, split_type
from ..backends.qos import asked_durations
from ..choices import Discovery
from .base import Halves
from .process.programs import reported_version
from .texts import element, xml_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from xml.etree.ElementTree import Element

    from dds_trace.tracefile.format.descriptions import Qos

    from .options import BridgeOptions, BridgeSide

PROGRAM = "rtiroutingservice"
CONFIGURATION_NAME = "dds_trace"
POOL_BUFFER_BYTES = 4096
"""Largest unbounded sample that comes from the pool; larger ones come from the heap, as RTI asks for such types."""

RTI_NAMES = {"uint8": "byte", "bool": "boolean"}
"""Plain type of ROS -> its name in RTI's XML, where the two differ."""


@dataclass(frozen=True, slots=True)
class RoutingService:
    """RTI Routing Service; see `Bridge` for the names."""

    name: str = "routing-service"
    install: str = (
        "it is part of RTI Connext Professional (https://www.rti.com) and needs its licence; "
        "set NDDSHOME and RTI_LICENSE_FILE"
    )
    halves: Halves = Halves.NEVER
    suffix: str = ".xml"
    up_pattern: str | None = "RTI Routing Service .*executing"
    needs_ros_nodes: bool = False

    def configuration(self, options: BridgeOptions) -> str:
        """Return XML: the types, and a domain route with a session each way and a topic route for each topic."""
        ping, relay = options.sides()
        types = sorted({topic.type_name for topic in options.topics})
        document = element(
            "dds",
            *_types(types),
            element(
                "routing_service",
                element(
                    "domain_route",
                    *(_participant(side, options) for side in (ping, relay)),
                    _session("ping_to_relay", ping, relay, options),
                    _session("relay_to_ping", relay, ping, options),
                    name="domains",
                ),
                name=CONFIGURATION_NAME,
            ),
        )
        return xml_text(document)

    def find(self) -> Path | None:
        """Return the program below NDDSHOME, else on the PATH."""
        home = os.environ.get("NDDSHOME")
        path = shutil.which(PROGRAM, path=str(Path(home) / "bin")) if home else None
        path = path or shutil.which(PROGRAM)
        return Path(path) if path else None

    def version(self, program: Path) -> str:
        """Return the line of `-version`."""
        return reported_version(program, "-version")

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the program with its file and the name of the configuration in it."""
        del options
        return (str(program), "-cfgFile", str(configuration), "-cfgName", CONFIGURATION_NAME)

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return no variables: it is no ROS 2 program."""
        del program, options
        return {}


BRIDGE = RoutingService()


def _participant(side: BridgeSide, options: BridgeOptions) -> Element:
    names = sorted({topic.dds_type_name for topic in options.topics})
    local = _localhost_qos() if options.discovery is Discovery.LOCALHOST else ()
    return element(
        "participant",
        element("domain_id", str(side.domain_id)),
        *local,
        *(element("registered_type", name=name, type_name=name) for name in names),
        name=f"domain_{side.domain_id}",
    )


def _localhost_qos() -> tuple[Element, ...]:
    """Return quality of service that uses UDP over the loopback interface alone and looks for others there."""
    return (
        element(
            "participant_qos",
            element("transport_builtin", element("mask", "UDPv4")),
            element("discovery", element("initial_peers", element("element", "builtin.udpv4://127.0.0.1"))),
            _properties({"dds.transport.UDPv4.builtin.parent.allow_interfaces_list": "127.0.0.1"}),
        ),
    )


def _session(name: str, here: BridgeSide, there: BridgeSide, options: BridgeOptions) -> Element:
    return element("session", *(_topic_route(topic, here, there, options) for topic in here.takes), name=name)


def _topic_route(name: str, here: BridgeSide, there: BridgeSide, options: BridgeOptions) -> Element:
    type_name = options.topic_of(name).dds_type_name
    stream = (
        element("registered_type_name", type_name),
        element("topic_name", f"rt/{name}"),
        element("creation_mode", "IMMEDIATE"),
    )
    return element(
        "topic_route",
        element("input", *stream, _reader_qos(options.qos), participant=f"domain_{here.domain_id}"),
        element("output", *stream, _writer_qos(options.qos), participant=f"domain_{there.domain_id}"),
        name=name,
    )


def _reader_qos(qos: Qos) -> Element:  # a lifespan is the writer's alone
    pool = "dds.data_reader.history.memory_manager.fast_pool.pool_buffer_max_size"
    return element("datareader_qos", *_common_qos(qos), _properties({pool: str(POOL_BUFFER_BYTES)}))


def _writer_qos(qos: Qos) -> Element:
    pool = "dds.data_writer.history.memory_manager.fast_pool.pool_buffer_max_size"
    return element(
        "datawriter_qos",
        *_common_qos(qos),
        *_duration(qos, "lifespan", "duration"),
        # Samples larger than a datagram are fragmented by the asynchronous publisher alone.
        element("publish_mode", element("kind", "ASYNCHRONOUS_PUBLISH_MODE_QOS")),
        _properties({pool: str(POOL_BUFFER_BYTES)}),
    )


def _common_qos(qos: Qos) -> tuple[Element, ...]:
    return (
        element("reliability", element("kind", f"{qos.reliability.upper()}_RELIABILITY_QOS")),
        element("durability", element("kind", f"{qos.durability.upper()}_DURABILITY_QOS")),
        element(
            "history", element("kind", f"{qos.history.upper()}_HISTORY_QOS"), element("depth", str(qos.depth))
        ),
        *_duration(qos, "deadline", "period"),
    )


def _duration(qos: Qos, policy: str, name: str) -> tuple[Element, ...]:
    """Return the element of `policy`, none if `qos` does not ask for that policy."""
    durations_ns = asked_durations(qos)
    if policy not in durations_ns:
        return ()
    seconds, nanoseconds = divmod(durations_ns[policy], SECOND_NS)
    return (
        element(policy, element(name, element("sec", str(seconds)), element("nanosec", str(nanoseconds)))),
    )


def _properties(values: Mapping[str, str]) -> Element:
    entries = (
        element("element", element("name", name), element("value", value)) for name, value in values.items()
    )
    return element("property", element("value", *entries))


def _types(type_names: list[str]) -> tuple[Element, ...]:
    """Return a `types` element that defines `type_names` and all types in them; none if `DDS_TYPES` has none of them.

    The program learns any other type from the nodes that it discovers.
    """
    needed: set[str] = set()
    for name in type_names:
        _collect(name, needed)
    packages = groupby(filter(needed.__contains__, DDS_TYPES), key=lambda name: name.split("/")[0])
    modules = [_package(package, list(names)) for package, names in packages]
    return (element("types", *modules),) if modules else ()


def _collect(name: str, needed: set[str]) -> None:
    if name in DDS_TYPES:
        needed.add(name)
        for text in DDS_TYPES[name].values():
            _collect(split_type(text)[0], needed)


def _package(package: str, names: list[str]) -> Element:
    inner = element("module", *map(_struct, names), name="dds_")
    return element("module", element("module", inner, name="msg"), name=package)


def _struct(name: str) -> Element:
    members = (_member(member, text) for member, text in DDS_TYPES[name].items())
    return element("struct", *members, name=dds_name(name)[2])


def _member(name: str, text: str) -> Element:
    kind, length = split_type(text)
    attributes = {"name": name, "type": RTI_NAMES.get(kind, kind)}
    if kind in DDS_TYPES:
        package, _, plain = dds_name(kind)
        attributes |= {"type": "nonBasic", "nonBasicTypeName": f"{package}::msg::dds_::{plain}"}
    if kind == "string":
        attributes["stringMaxLength"] = "-1"
    if length is not None:
        attributes |= {"arrayDimensions": str(length)} if length else {"sequenceMaxLength": "-1"}
    return element("member", **attributes)
