"""`routing-service`: RTI's Routing Service, the paper's choice for Connext."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.durations import SECOND_NS

from ..backends.qos import asked_durations
from ..choices import Discovery
from .base import Halves
from .process.programs import reported_version
from .ros_types import rti_types
from .texts import element, xml_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from xml.etree.ElementTree import Element

    from dds_trace.tracefile import Qos

    from .base import BridgeOptions, BridgeSide

PROGRAM = "rtiroutingservice"
CONFIGURATION_NAME = "dds_trace"
POOL_BUFFER_BYTES = 4096
"""Unbounded samples up to this size come from the pool, larger ones from the heap, as RTI asks for such types."""


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

    def configuration(self, options: BridgeOptions) -> str:
        """XML: the types, and a domain route with a session each way and a topic route for each topic."""
        ping, relay = options.sides()
        types = sorted({topic.type_name for topic in options.topics})
        document = element(
            "dds",
            *rti_types(types),
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
        """Below NDDSHOME, else on the PATH."""
        home = os.environ.get("NDDSHOME")
        found = shutil.which(PROGRAM, path=str(Path(home) / "bin")) if home else None
        found = found or shutil.which(PROGRAM)
        return Path(found) if found else None

    def version(self, program: Path) -> str:
        """As `-version` says it."""
        return reported_version(program, "-version")

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """The program with its file and the name of the configuration in it."""
        del options
        return (str(program), "-cfgFile", str(configuration), "-cfgName", CONFIGURATION_NAME)

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Nothing; it is no ROS 2 program."""
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
    """UDP over the loopback interface alone, looking for others there."""
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
    type_name = next(t.dds_type_name for t in options.topics if name in (t.name, t.reply_name))
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
    """The element of `policy`, nothing if `qos` does not ask for one."""
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
