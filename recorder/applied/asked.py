"""`Asked`: the settings that a run requests, as a read-back can contradict them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as ET

import psutil

from dds_trace.base.files import read_regular
from dds_trace.base.units import UNIT_BYTES

from .vendors import vendor_facts

_BUILTIN_TRANSPORTS = {"UDPv4": "udp", "UDPv6": "udp", "SHM": "shm", "LARGE_DATA": "large-data"}
_SOCKETS_SIZE = re.compile(r"\bsockets_size=(\d+)([A-Za-z]*)")

_INTERFACE = re.compile(r"<NetworkInterface\b[^>]*\bname=[\"']([^\"']+)[\"']")


@dataclass(frozen=True, slots=True)
class Asked:
    """Settings that one side requests (docs/trace-format.md); 0, empty and None leave them to the system or the vendor."""

    vendor: str
    domain_id: int = 0
    transport: str = "default"
    tuned: bool = False
    discovery: str = "subnet"
    receive_buffer_bytes: int = 0
    send_buffer_bytes: int = 0
    shared_memory: bool | None = None
    interface: str = ""
    profile: str = ""
    congestion_control: str = ""
    buffer_is_exact: bool = False
    segment_bytes: int = 0


def asked_settings(
    vendor: str,
    *,
    domain_id: int,
    transport: str = "default",
    tuned: bool = False,
    discovery: str = "subnet",
    congestion_control: str | None = None,
    environment: Mapping[str, str] | None = None,
    settings: Mapping[str, str] | None = None,
    profile: str = "",
    buffer_bytes: int | None = None,
    segment_bytes: int | None = None,
) -> Asked:
    """Return what options (`Middleware.settings`) and the user's configuration, `environment` and Fast DDS `profile` request."""
    facts = vendor_facts(vendor)
    uri = (settings or {}).get("CYCLONEDDS_URI", (environment or {}).get("CYCLONEDDS_URI", ""))
    requested = Asked(
        vendor,
        domain_id,
        facts.tuned.transport if tuned and transport == "default" else transport,
        tuned,
        discovery,
        facts.tuned.receive_bytes if tuned else 0,
        shared_memory=facts.shared_memory.get(transport),
        interface=interface_named(uri) if vendor == "cyclonedds" else "",
        congestion_control=congestion_control or "",
        segment_bytes=segment_bytes or int((settings or {}).get("segment_bytes", 0)),
    )
    if vendor == "fastdds" and requested.transport == "default":
        requested = _asked_by_environment(requested, environment or {}, profile)
    if buffer_bytes is not None:
        sending_bytes = buffer_bytes if facts.tcp_has_both_buffers and transport != "udp" else 0
        requested = replace(
            requested, receive_buffer_bytes=buffer_bytes, send_buffer_bytes=sending_bytes, buffer_is_exact=True
        )
    return requested


def interface_named(cyclonedds_uri: str) -> str:
    names = {name for text in configuration_texts(cyclonedds_uri) for name in _INTERFACE.findall(text)}
    return names.pop() if len(names) == 1 else ""


def configuration_texts(cyclonedds_uri: str) -> list[str]:
    parts = re.split(r",(?=\s*(?:<|file:|/))", cyclonedds_uri)
    return [part if part.lstrip().startswith("<") else file_text(part) for part in parts]


def _asked_by_environment(requested: Asked, environment: Mapping[str, str], profile: str) -> Asked:
    if profile:
        request = read_profile_request(file_text(profile))
        return replace(
            requested,
            transport=request.transport,
            receive_buffer_bytes=request.receive_buffer_bytes,
            send_buffer_bytes=request.send_buffer_bytes,
            interface=_interface_at(*request.interfaces) if len(request.interfaces) == 1 else "",
            profile=Path(profile).name,
            segment_bytes=request.segment_bytes,
        )
    name, _, options = environment.get("FASTDDS_BUILTIN_TRANSPORTS", "").partition("?")
    size = _SOCKETS_SIZE.search(options)
    # Fast DDS ignores the options of a transport without sockets.
    size_bytes = int(size[1]) * UNIT_BYTES.get(size[2].lower(), 0) if size and name != "SHM" else 0
    return replace(
        requested,
        transport=_BUILTIN_TRANSPORTS.get(name, "default"),
        receive_buffer_bytes=size_bytes,
        send_buffer_bytes=size_bytes,
    )


def _interface_at(name: str) -> str:
    for interface, addresses in psutil.net_if_addrs().items():
        if name == interface or name in [address.address for address in addresses]:
            return str(interface)
    return ""


def file_text(entry: str) -> str:
    try:
        return read_regular(Path(entry.strip().removeprefix("file://"))).decode(errors="replace")
    except OSError:
        return ""


_KINDS = {"UDPv4": "udp", "UDPv6": "udp", "TCPv4": "tcp", "TCPv6": "tcp", "SHM": "shm"}


@dataclass(frozen=True, slots=True)
class ProfileRequest:
    """What the default participant of a Fast DDS profile requests; of buffers the smallest, 0 if a transport has none."""

    protocols: tuple[str, ...] = ()
    receive_buffer_bytes: int = 0
    send_buffer_bytes: int = 0
    interfaces: tuple[str, ...] = ()
    segment_bytes: int = 0

    @property
    def transport(self) -> str:
        return self.protocols[0] if len(self.protocols) == 1 and self.protocols[0] != "tcp" else "default"


def read_profile_request(text: str) -> ProfileRequest:
    try:
        root = ET.fromstring(text)  # noqa: S314 - the user's own file
    except ET.ParseError:
        return ProfileRequest()
    participants = [node for node in _named(root, "participant") if node.get("is_default_profile") == "true"]
    if not participants:
        return ProfileRequest()
    descriptors = {_text(node, "transport_id"): node for node in _named(root, "transport_descriptor")}
    transports = [
        descriptors[name]
        for group in _named(participants[0], "userTransports")
        for node in _named(group, "transport_id")
        if (name := (node.text or "").strip()) in descriptors
    ]
    kinds = [_KINDS.get(_text(transport, "type"), "") for transport in transports]
    over_udp, in_memory = (
        [transport for transport, kind in zip(transports, kinds, strict=True) if kind == wanted]
        for wanted in ("udp", "shm")
    )
    return ProfileRequest(
        protocols=tuple(sorted({*kinds} - {""})),
        receive_buffer_bytes=_smallest(over_udp, "receiveBufferSize"),
        send_buffer_bytes=_smallest(over_udp, "sendBufferSize"),
        interfaces=tuple(sorted({name for transport in transports for name in _whitelist(transport)})),
        segment_bytes=_smallest(in_memory, "segment_size"),
    )


def _named(parent: ET.Element, name: str) -> Iterator[ET.Element]:
    return (node for node in parent.iter() if node.tag.rpartition("}")[2] == name)  # whatever the XML namespace


def _whitelist(descriptor: ET.Element) -> Iterator[str]:
    for name in ("interfaceWhiteList", "allowlist"):
        for group in _named(descriptor, name):
            for node in group:
                if text := (node.get("name") or node.text or "").strip():
                    yield text


def _text(parent: ET.Element, name: str) -> str:
    return next(((node.text or "").strip() for node in _named(parent, name)), "")


def _smallest(descriptors: list[ET.Element], name: str) -> int:
    texts = [_text(descriptor, name) for descriptor in descriptors]
    return min((int(text) if text.isdigit() else 0 for text in texts), default=0)
