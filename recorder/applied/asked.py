"""`Asked`: the settings that a run was asked for, in the form in which a read-back can contradict them."""

from __future__ import annotations

import re
from collections.abc import Mapping  # noqa: TC003 - `from_json` looks the types of the fields up
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from .profile_request import read_profile_request
from .records import from_json, to_json
from .vendors import VENDORS, vendor_facts

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import JsonObject

PROFILE_VARIABLES = VENDORS["fastdds"].profile_variables
"""Where Fast DDS 2 and Fast DDS 3 look for the user's profile file."""

_BUILTIN_TRANSPORTS = {"UDPv4": "udp", "UDPv6": "udp", "SHM": "shm", "LARGE_DATA": "large-data"}
_SOCKETS_SIZE = re.compile(r"\bsockets_size=(\d+)([A-Za-z]*)")
_UNITS = {
    "": 1,
    "B": 1,
    "KB": 1000,
    "MB": 1000**2,
    "GB": 1000**3,
    "KIB": 1 << 10,
    "MIB": 1 << 20,
    "GIB": 1 << 30,
}

_INTERFACE = re.compile(r"<NetworkInterface\b[^>]*\bname=[\"']([^\"']+)[\"']")


@dataclass(frozen=True, slots=True)
class Asked:
    """Settings that one side was asked for.

    Attributes:
        vendor: middleware, as in the session.
        domain_id: DDS domain, which tells the ports.
        transport: `default`, `udp`, `shm`, `large-data` or `tcp`; of a profile file what its transports amount to.
        tuned: whether `--tuned` was given.
        discovery: `localhost` or `subnet`.
        receive_buffer_bytes: receive buffer that sockets are set to, 0 for the system's default.
        send_buffer_bytes: send buffer likewise.
        shared_memory: asked to be on or off, None if the vendor decides.
        congestion_control: TCP congestion control, empty for the system's.
        interface: the one interface that a configuration names, empty if it names none or several.
        profile: file name of the user's own profile, empty if there is none.
    """

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

    def to_json(self) -> JsonObject:
        """Return the JSON object of the session's field `asked`."""
        return to_json(self)

    @classmethod
    def from_json(cls, data: JsonObject) -> Asked:
        """Return what `to_json` wrote; fields that this version does not know are skipped.

        Raises:
            TypeError: `data` has no `vendor`.
        """
        return from_json(cls, data)


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
) -> Asked:
    """Return what the options of a recording and the user's configuration ask for.

    Args:
        vendor: middleware, as the running node names it.
        domain_id: DDS domain.
        transport: value of `--transport`.
        tuned: whether `--tuned` was given.
        discovery: value of `--discovery`.
        congestion_control: value of `--congestion-control`.
        environment: variables as the user set them, without what the recorder adds.
        settings: `Middleware.settings` of the node, whose CYCLONEDDS_URI includes the recorder's own part; the user's own
            counts where it has none (rmw_cyclonedds).
    """
    shared_memory = vendor_facts(vendor).shared_memory.get(transport)
    asked = Asked(vendor, domain_id, transport, tuned, discovery, shared_memory=shared_memory)
    if congestion_control is not None:
        asked = replace(asked, congestion_control=congestion_control)
    if tuned:
        facts = vendor_facts(vendor).tuned
        asked = replace(
            asked,
            transport=facts.transport if transport == "default" else transport,
            receive_buffer_bytes=facts.receive_bytes,
            send_buffer_bytes=facts.send_bytes,
        )
    if vendor == "cyclonedds":
        uri = (settings or {}).get("CYCLONEDDS_URI", (environment or {}).get("CYCLONEDDS_URI", ""))
        return replace(asked, interface=interface_named(uri))
    if vendor == "fastdds" and asked.transport == "default":
        return _asked_by_environment(asked, environment or {})
    return asked


def interface_named(cyclonedds_uri: str) -> str:
    """Return the one interface that a value of CYCLONEDDS_URI names, empty if it names none or several."""
    names = {name for text in configuration_texts(cyclonedds_uri) for name in _INTERFACE.findall(text)}
    return names.pop() if len(names) == 1 else ""


def configuration_texts(cyclonedds_uri: str) -> list[str]:
    """Return the XML of each part of a value of CYCLONEDDS_URI, inline or of a file; empty for a file that is not there."""
    parts = re.split(r",(?=\s*(?:<|file:|/))", cyclonedds_uri)
    return [part if part.lstrip().startswith("<") else _file_text(part) for part in parts]


def _asked_by_environment(asked: Asked, environment: Mapping[str, str]) -> Asked:
    """Return `asked` with the transports that the user's profile file names, or FASTDDS_BUILTIN_TRANSPORTS without one."""
    path = next((environment[name] for name in PROFILE_VARIABLES if environment.get(name)), "")
    if path:
        request = read_profile_request(_file_text(path))
        return replace(
            asked,
            transport=request.transport,
            receive_buffer_bytes=request.receive_buffer_bytes,
            send_buffer_bytes=request.send_buffer_bytes,
            interface=_interface_at(request.interfaces[0]) if len(request.interfaces) == 1 else "",
            profile=Path(path).name,
        )
    name, _, options = environment.get("FASTDDS_BUILTIN_TRANSPORTS", "").partition("?")
    found = _SOCKETS_SIZE.search(options)
    # Fast DDS ignores the options of a transport without sockets.
    size_bytes = int(found[1]) * _UNITS.get(found[2].upper(), 0) if found and name != "SHM" else 0
    return replace(
        asked,
        transport=_BUILTIN_TRANSPORTS.get(name, "default"),
        receive_buffer_bytes=size_bytes,
        send_buffer_bytes=size_bytes,
    )


def _interface_at(name: str) -> str:
    """Return the interface that has an address, or that is called so; empty if none does."""
    for interface, addresses in psutil.net_if_addrs().items():
        if name == interface or name in [each.address for each in addresses]:
            return str(interface)
    return ""


def _file_text(entry: str) -> str:
    try:
        return Path(entry.strip().removeprefix("file://")).read_text(errors="replace")
    except OSError:
        return ""
