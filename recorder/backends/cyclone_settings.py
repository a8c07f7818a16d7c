"""Settings of Cyclone DDS for the `cyclonedds` backend and zenoh's bridges, which contain it; its DDS Security, and quality of service."""

# ruff: noqa: PLC0415 - loaded with a node: bridges need the settings only

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.tracefile.format.descriptions import Qos

from ..applied.asked import configuration_texts
from ..choices import Discovery, Durability, History, Reliability
from ..security.keys import enclave
from .dds_types import dds_name
from .node import NodeOptions
from .qos import duration_extra, requested_durations
from .sizes import VENDORS_SIZES, Sizes

# ROS 2's LOCALHOST range has no multicast: its nodes look for others at the well-known unicast ports of 127.0.0.1.
# Cyclone DDS uses such a port only with a participant index, and finds the nodes only as peers.
CYCLONE_LOCALHOST = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>31</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)

# Without this Cyclone DDS sends data for this machine through an interface of the network.
CYCLONE_LOOPBACK = '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces></General></Domain></CycloneDDS>'

# Participants find each other by multicast, and data go to each reader by itself.
CYCLONE_UNICAST = "<CycloneDDS><Domain><General><AllowMulticast>spdp</AllowMulticast></General></Domain></CycloneDDS>"

_NAMES_LOOPBACK = re.compile(
    r"<NetworkInterface\b[^>]*\b(?:name=[\"']lo[\"']|address=[\"']127\.)"
    r"|<NetworkInterfaceAddress>\s*(?:lo|127\.[\d.]+)\s*<"  # before Cyclone DDS 0.10
)

# By default Cyclone DDS sends fragments of 1344 bytes into small buffers: another vendor's large message then loses
# fragments faster than they are sent again.
CYCLONE_TUNED = (
    "<CycloneDDS><Domain><General><MaxMessageSize>65500B</MaxMessageSize><FragmentSize>60000B</FragmentSize></General>"
    '<Internal><SocketReceiveBufferSize min="default" max="4MB"/></Internal></Domain></CycloneDDS>'
)


# Cyclone DDS 11 drops endpoints whose type objects it rejects: of Fast DDS 3 (vendor 1.15) all with an array or sequence.
_IGNORED_TYPES = "<CycloneDDS><Domain><Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"


def ignored_types(version: str, environment: Mapping[str, str] = os.environ) -> str:
    """Return the setting that lets endpoints of Fast DDS 3 match; empty where this version has none, or the user set it."""
    texts = configuration_texts(environment.get("CYCLONEDDS_URI", ""))
    is_set = any("IgnoreTypeInformation" in text for text in texts)
    return "" if is_set or version.startswith("0.") else _IGNORED_TYPES


def cyclone_loopback(discovery: Discovery, environment: Mapping[str, str] = os.environ) -> str:
    """Return the setting that keeps Cyclone DDS on the loopback interface, to precede `cyclone_settings`.

    It is empty beyond this machine, and where the user names that interface: named twice, Cyclone DDS does not start.
    """
    texts = configuration_texts(environment.get("CYCLONEDDS_URI", ""))
    if discovery is not Discovery.LOCALHOST or any(_NAMES_LOOPBACK.search(text) for text in texts):
        return ""
    return CYCLONE_LOOPBACK


_FRAGMENTS = (
    "<CycloneDDS><Domain><General><MaxMessageSize>{packet}B</MaxMessageSize><FragmentSize>{fragment}B</FragmentSize></General>"
    "</Domain></CycloneDDS>"
)
_BUFFER = '<CycloneDDS><Domain><Internal><SocketReceiveBufferSize min="default" max="{bytes}B"/></Internal></Domain></CycloneDDS>'
_HEADERS_BYTES = 256
"""Room of RTPS headers next to a fragment."""


def cyclone_settings(
    discovery: Discovery,
    *,
    tuned: bool,
    multicast: bool = True,
    environment: Mapping[str, str] = os.environ,
    sizes: Sizes = VENDORS_SIZES,
    on_loopback: bool = False,
) -> str:
    """Return a value of CYCLONEDDS_URI; our settings win over the user's."""
    parts = [
        cyclone_loopback(discovery, environment) if on_loopback else "",
        environment.get("CYCLONEDDS_URI", ""),
        "" if multicast else CYCLONE_UNICAST,
        CYCLONE_LOCALHOST if discovery is Discovery.LOCALHOST else "",
        CYCLONE_TUNED if tuned else "",
        _FRAGMENTS.format(packet=sizes.fragment + _HEADERS_BYTES, fragment=sizes.fragment) if sizes.fragment else "",
        _BUFFER.format(bytes=sizes.buffer) if sizes.buffer else "",
    ]
    return ",".join(filter(None, parts))


_PLUGIN = re.compile(r"libdds_security_\w+\.so")

_SECURITY = """<CycloneDDS><Domain><Security>
<Authentication>
<Library initFunction="init_authentication" finalizeFunction="finalize_authentication" path="{1}/libdds_security_auth.so"/>
<IdentityCA>file:{0}/identity_ca.cert.pem</IdentityCA>
<IdentityCertificate>file:{0}/cert.pem</IdentityCertificate>
<PrivateKey>file:{0}/key.pem</PrivateKey>
</Authentication>
<Cryptographic>
<Library initFunction="init_crypto" finalizeFunction="finalize_crypto" path="{1}/libdds_security_crypto.so"/>
</Cryptographic>
<AccessControl>
<Library initFunction="init_access_control" finalizeFunction="finalize_access_control" path="{1}/libdds_security_ac.so"/>
<PermissionsCA>file:{0}/permissions_ca.cert.pem</PermissionsCA>
<Governance>file:{0}/governance.p7s</Governance>
<Permissions>file:{0}/permissions.p7s</Permissions>
</AccessControl>
</Security></Domain></CycloneDDS>"""


def security_settings(options: NodeOptions) -> str:
    """Return the part of CYCLONEDDS_URI, which is in no trace; empty without keys. A `BackendUnavailableError` without its plugins."""
    if options.keys is None:
        return ""
    # The plugins are next to the library of this process, or where Debian has them.
    library = re.search(r"/\S*libddsc\S*\.so\S*", _maps())
    folder = Path(library[0]).parent if library else Path()
    folders = (folder, folder / "libddsc0debian")
    plugins = next((folder for folder in folders if (folder / "libdds_security_auth.so").exists()), None)
    if plugins is None:
        raise BackendUnavailableError(
            f"-o security={options.security.value}: this Cyclone DDS has no security plugins, as none from pip has; build the package "
            "cyclonedds 0.10.2 against Debian's cyclonedds-dev (docs/how-to/axes.md)"
        )
    return _SECURITY.format(enclave(options.keys, listens=options.listens), plugins)


def loaded_plugins() -> str:
    return ", ".join(sorted(set(_PLUGIN.findall(_maps()))))


def library_version() -> dict[str, str]:
    version = re.search(r"libddsc\S*\.so\.([\d.]+)", _maps())
    return {"libddsc": version[1]} if version else {}


def _maps() -> str:
    return Path("/proc/self/maps").read_text()


FOREVER_NS = (1 << 63) - 1


def cyclone_qos(qos: Qos, priority: int | None = None) -> Any:
    from cyclonedds.qos import Policy
    from cyclonedds.qos import Qos as CycloneQos

    values: dict[str, Any] = {
        # As in ROS 2 a writer waits for a slow reader and drops nothing.
        Reliability.RELIABLE: Policy.Reliability.Reliable(max_blocking_time=FOREVER_NS),
        Reliability.BEST_EFFORT: Policy.Reliability.BestEffort,
        Durability.VOLATILE: Policy.Durability.Volatile,
        Durability.TRANSIENT_LOCAL: Policy.Durability.TransientLocal,
        History.KEEP_LAST: Policy.History.KeepLast(qos.depth),
        History.KEEP_ALL: Policy.History.KeepAll,
    }
    try:
        policies = [values[value] for value in (qos.reliability, qos.durability, qos.history)]
    except KeyError as err:
        raise OptionError(f"Cyclone DDS has no quality of service {err}") from err
    durations = {"deadline": Policy.Deadline, "lifespan": Policy.Lifespan}
    policies += [durations[policy](duration_ns) for policy, duration_ns in requested_durations(qos).items()]
    if priority is not None:
        policies.append(Policy.TransportPriority(priority))
    if qos.durability == Durability.TRANSIENT_LOCAL:  # late readers get as much as in ROS 2
        policies.append(Policy.DurabilityService(0, values[qos.history], -1, -1, -1))
    return CycloneQos(*policies)


def qos_of(policies: Any) -> Qos:
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


def priority_of(writer: Any) -> int:
    from cyclonedds.qos import Policy

    qos = writer.get_qos()
    return int(qos[Policy.TransportPriority].priority) if Policy.TransportPriority in qos else 0


def opaque_type(type_name: str) -> Any:
    """Return a type of one octet: Cyclone DDS accepts what follows in a message."""
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl.types import uint8

    name = (dds_name(type_name) if type_name.count("/") == 2 else type_name).replace("::", ".")
    return make_idl_struct(name.rpartition(".")[2], name, {"octet": uint8})
