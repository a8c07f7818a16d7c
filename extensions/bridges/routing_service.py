"""`routing-service`: RTI's Routing Service, the paper's choice for Connext."""

from __future__ import annotations

import os
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from xml.etree.ElementTree import Element

from dds_trace.base.units import SECOND_NS
from dds_trace.recorder.backends.dds_types import DDS_TYPES, dds_name, split_type
from dds_trace.recorder.backends.qos import requested_durations
from dds_trace.recorder.choices import Discovery
from dds_trace.tracefile.format.descriptions import Qos

from .base import Bridge, BridgeOptions, BridgeSide
from .programs import program_on_path, reported_version
from .texts import element, xml_text

PROGRAM = "rtiroutingservice"
CONFIGURATION_NAME = "dds_trace"
POOL_BUFFER_BYTES = 4096
"""Largest unbounded sample from the pool; RTI wants larger ones on the heap."""

RTI_NAMES = {"uint8": "byte", "bool": "boolean"}
"""ROS types that RTI's XML names differently."""


def _configuration(options: BridgeOptions) -> str:
    ping, relay = options.sides()
    document = element(
        "dds",
        *_types(sorted({topic.type_name for topic in options.topics})),
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


def _find() -> Path | None:
    home = os.environ.get("NDDSHOME")
    return (program_on_path(PROGRAM, Path(home) / "bin") if home else None) or program_on_path(PROGRAM)


BRIDGE = Bridge(
    name="routing-service",
    install=(
        "it is part of RTI Connext Professional (https://www.rti.com) and needs its licence; "
        "set NDDSHOME and RTI_LICENSE_FILE"
    ),
    tried="never run: no licence",
    suffix=".xml",
    configuration=_configuration,
    find=_find,
    version=lambda program: reported_version(program, "-version"),
    arguments=lambda _: ("-cfgName", CONFIGURATION_NAME, "-cfgFile"),
    up_pattern="RTI Routing Service .*executing",
)


def _participant(side: BridgeSide, options: BridgeOptions) -> Element:
    names = sorted({dds_name(topic.type_name) for topic in options.topics})
    # UDP over the loopback interface, and a search for participants there only.
    local = (
        element(
            "participant_qos",
            element("transport_builtin", element("mask", "UDPv4")),
            element("discovery", element("initial_peers", element("element", "builtin.udpv4://127.0.0.1"))),
            _properties({"dds.transport.UDPv4.builtin.parent.allow_interfaces_list": "127.0.0.1"}),
        ),
    )
    return element(
        "participant",
        element("domain_id", str(side.domain_id)),
        *(local if options.discovery is Discovery.LOCALHOST else ()),
        *(element("registered_type", name=name, type_name=name) for name in names),
        name=f"domain_{side.domain_id}",
    )


def _session(name: str, source: BridgeSide, there: BridgeSide, options: BridgeOptions) -> Element:
    return element("session", *(_topic_route(topic, source, there, options) for topic in source.takes), name=name)


def _topic_route(name: str, source: BridgeSide, there: BridgeSide, options: BridgeOptions) -> Element:
    type_name = dds_name(options.type_of(name))
    stream = (
        element("registered_type_name", type_name),
        element("topic_name", f"rt/{name}"),
        element("creation_mode", "IMMEDIATE"),
    )
    return element(
        "topic_route",
        element("input", *stream, _reader_qos(options.qos), participant=f"domain_{source.domain_id}"),
        element("output", *stream, _writer_qos(options.qos), participant=f"domain_{there.domain_id}"),
        name=name,
    )


def _reader_qos(qos: Qos) -> Element:  # only a writer has a lifespan
    pool = "dds.data_reader.history.memory_manager.fast_pool.pool_buffer_max_size"
    return element("datareader_qos", *_common_qos(qos), _properties({pool: str(POOL_BUFFER_BYTES)}))


def _writer_qos(qos: Qos) -> Element:
    pool = "dds.data_writer.history.memory_manager.fast_pool.pool_buffer_max_size"
    return element(
        "datawriter_qos",
        *_common_qos(qos),
        *_duration(qos, "lifespan", "duration"),
        # Only the asynchronous publisher fragments samples larger than a datagram.
        element("publish_mode", element("kind", "ASYNCHRONOUS_PUBLISH_MODE_QOS")),
        _properties({pool: str(POOL_BUFFER_BYTES)}),
    )


def _common_qos(qos: Qos) -> tuple[Element, ...]:
    return (
        element("reliability", element("kind", f"{qos.reliability.upper()}_RELIABILITY_QOS")),
        element("durability", element("kind", f"{qos.durability.upper()}_DURABILITY_QOS")),
        element("history", element("kind", f"{qos.history.upper()}_HISTORY_QOS"), element("depth", str(qos.depth))),
        *_duration(qos, "deadline", "period"),
    )


def _duration(qos: Qos, policy: str, name: str) -> tuple[Element, ...]:
    duration_ns = requested_durations(qos).get(policy)
    if duration_ns is None:
        return ()
    seconds, nanoseconds = divmod(duration_ns, SECOND_NS)
    return (element(policy, element(name, element("sec", str(seconds)), element("nanosec", str(nanoseconds)))),)


def _properties(values: Mapping[str, str]) -> Element:
    entries = (element("element", element("name", name), element("value", value)) for name, value in values.items())
    return element("property", element("value", *entries))


def _types(type_names: list[str]) -> tuple[Element, ...]:
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
    members = {name: [_member(member, text) for member, text in DDS_TYPES[name].items()] for name in names}
    structs = (element("struct", *members[name], name=dds_name(name).rpartition("::")[2]) for name in names)
    return element("module", element("module", element("module", *structs, name="dds_"), name="msg"), name=package)


def _member(name: str, text: str) -> Element:
    kind, length = split_type(text)
    attributes = {"name": name, "type": RTI_NAMES.get(kind, kind)}
    if kind in DDS_TYPES:
        attributes |= {"type": "nonBasic", "nonBasicTypeName": dds_name(kind)}
    if kind == "string":
        attributes["stringMaxLength"] = "-1"
    if length is not None:
        attributes |= {"arrayDimensions": str(length)} if length else {"sequenceMaxLength": "-1"}
    return element("member", **attributes)
