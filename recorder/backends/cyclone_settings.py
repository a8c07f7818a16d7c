"""Settings of Cyclone DDS for the `cyclonedds` backend and zenoh's bridges, which contain it, and its DDS Security."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError

from ..applied.asked import configuration_texts
from ..choices import Discovery
from ..security.keys import enclave
from .sizes import VENDORS_SIZES, Sizes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .node import NodeOptions

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
_BUFFER = '<CycloneDDS><Domain><Internal><SocketReceiveBufferSize min="{bytes}B" max="{bytes}B"/></Internal></Domain></CycloneDDS>'
_HEADERS_BYTES = 256
"""Room of RTPS headers next to a fragment."""


def cyclone_settings(
    discovery: Discovery,
    *,
    tuned: bool,
    multicast: bool = True,
    environment: Mapping[str, str] = os.environ,
    sizes: Sizes = VENDORS_SIZES,
) -> str:
    """Return a value of CYCLONEDDS_URI; our settings win over the user's."""
    parts = [
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
    """Return the part of CYCLONEDDS_URI, which is in no trace; empty without keys.

    Raises:
        BackendUnavailableError: the loaded Cyclone DDS has no plugins.
    """
    if options.keys is None:
        return ""
    # The plugins are next to the library of this process, or where Debian has them.
    library = re.search(r"/\S*libddsc\S*\.so\S*", Path("/proc/self/maps").read_text())
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
    return ", ".join(sorted(set(_PLUGIN.findall(Path("/proc/self/maps").read_text()))))
