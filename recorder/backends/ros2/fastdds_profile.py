"""A Fast DDS profile of our own for ROS 2's LOCALHOST range, where FASTDDS_BUILTIN_TRANSPORTS changes nothing.

For ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST rmw_fastrtps sets `use_builtin_transports` to false and appends a shared-memory
and a UDP transport of its own to those of the default profile (rmw_fastrtps_shared_cpp/src/participant.cpp), so neither the
variable nor a profile takes shared memory away. Our way: the range SYSTEM_DEFAULT, which leaves the profile as it is, and a
profile that is the LOCALHOST range itself: sockets on 127.0.0.1 alone, no multicast beyond it, the same unicast search for
participants. Read back with Fast DDS 2.14.5: no shared memory, every socket on 127.0.0.1, buffers as asked; nodes of the
LOCALHOST range and our own still find each other.

Fast DDS loads one profile file, once for each process, when its first participant is made. So all nodes of a process have
the same transports, and a profile of the user's own excludes ours: the options are refused beside it.

Beyond this machine FASTDDS_BUILTIN_TRANSPORTS does what it says (`installation.set_transport`).
"""

from __future__ import annotations

import os
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

from ...applied.asked import PROFILE_VARIABLES
from ...applied.vendors import BUFFER_BYTES, ros_middleware
from ...choices import Discovery, Transport
from .installation import NO_TUNING, package_version, set_transport

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from ..node import NodeOptions

RANGE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
"""Leaves discovery to the profile; also ROS_STATIC_PEERS is ignored then."""

MAX_PEERS = 32
"""Participants of one domain on this machine that are searched for: as many as rmw_fastrtps's LOCALHOST range has."""

_UDP, _SHM, _TCP = "dds_trace_udp", "dds_trace_shm", "dds_trace_tcp"

_WHITELIST = "        <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>\n"

_DESCRIPTORS = {
    _SHM: "        <type>SHM</type>\n",
    # As Fast DDS sets TCP up for LARGE_DATA: a port that the kernel chooses, no checksum of its own, no delay.
    _TCP: (
        "        <type>TCPv4</type>\n"
        + _WHITELIST
        + "        <listening_ports><port>0</port></listening_ports>\n"
        + "        <calculate_crc>false</calculate_crc>\n"
        + "        <check_crc>false</check_crc>\n"
        + "        <enable_tcp_nodelay>true</enable_tcp_nodelay>\n"
    ),
    _UDP: (
        "        <type>UDPv4</type>\n"
        "{buffers}" + _WHITELIST + f"        <maxInitialPeersRange>{MAX_PEERS}</maxInitialPeersRange>\n"
    ),
}

_BUFFERS = """\
        <sendBufferSize>{bytes}</sendBufferSize>
        <receiveBufferSize>{bytes}</receiveBufferSize>
"""

# An empty locator stands for the well-known unicast port, and keeps Fast DDS from opening its multicast one.
_UNICAST_DISCOVERY = """\
        <builtin>
          <metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>
          <initialPeersList>
            <locator><udpv4><address>127.0.0.1</address></udpv4></locator>
          </initialPeersList>
        </builtin>
"""

# LARGE_DATA finds participants by multicast and tells them of endpoints over TCP; the whitelist keeps both on loopback.
_LARGE_DATA_DISCOVERY = """\
        <builtin>
          <metatrafficUnicastLocatorList>
            <locator><tcpv4><physical_port>0</physical_port><port>0</port><address>0.0.0.0</address></tcpv4></locator>
          </metatrafficUnicastLocatorList>
          <metatrafficMulticastLocatorList>
            <locator><udpv4><address>239.255.0.1</address></udpv4></locator>
          </metatrafficMulticastLocatorList>
          <initialPeersList>
            <locator><udpv4><address>239.255.0.1</address></udpv4></locator>
          </initialPeersList>
        </builtin>
"""

_PROFILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<!-- Written by dds-trace: {transport} on this machine alone. -->
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
{descriptors}    </transport_descriptors>
    <participant profile_name="dds_trace" is_default_profile="true">
      <rtps>
        <userTransports>
{transports}        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
{discovery}      </rtps>
    </participant>
  </profiles>
</dds>
"""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Transports of a profile, and how its participants find each other (by shared memory alone where that is empty)."""

    transports: tuple[str, ...]
    discovery: str = ""


_LAYOUTS = {
    Transport.UDP: _Layout((_UDP,), _UNICAST_DISCOVERY),
    Transport.SHM: _Layout((_SHM,)),
    Transport.LARGE_DATA: _Layout((_SHM, _TCP, _UDP), _LARGE_DATA_DISCOVERY),
}


def localhost_profile(transport: Transport, buffer_bytes: int | None = None) -> str:
    """Return the text of a profile that keeps a transport on this machine.

    Args:
        transport: UDP, SHM or LARGE_DATA.
        buffer_bytes: send and receive buffer of the UDP sockets, None for the system's default.

    Raises:
        OptionError: the transport needs no profile, or has no buffers to set.
    """
    layout = _LAYOUTS.get(transport)
    if layout is None:
        raise OptionError(f"--transport {transport.value}: ROS 2's own LOCALHOST range is that already")
    if buffer_bytes is not None and transport is not Transport.UDP:
        raise OptionError(NO_TUNING.format(transport.value))
    buffers = "" if buffer_bytes is None else _BUFFERS.format(bytes=buffer_bytes)
    return _PROFILE.format(
        transport=transport.value,
        descriptors="".join(_descriptor(name, buffers) for name in layout.transports),
        transports="".join(f"          <transport_id>{name}</transport_id>\n" for name in layout.transports),
        discovery=layout.discovery,
    )


def _descriptor(name: str, buffers: str) -> str:
    body = _DESCRIPTORS[name].format(buffers=buffers)
    return (
        "      <transport_descriptor>\n"
        f"        <transport_id>{name}</transport_id>\n"
        f"{body}"
        "      </transport_descriptor>\n"
    )


def asked_profile(transport: Transport, *, tuned: bool) -> str | None:
    """Return the profile for `--transport` and `--tuned` under localhost discovery, None if they ask for nothing.

    Raises:
        OptionError: the two do not go together.
    """
    if transport is Transport.DEFAULT and not tuned:
        return None
    # A tuned default is UDP: what tuning enlarges are the buffers of sockets.
    chosen = Transport.UDP if transport is Transport.DEFAULT else transport
    # As `sockets_size=4MB` of FASTDDS_BUILTIN_TRANSPORTS, whose MB is 1,000,000 bytes.
    return localhost_profile(chosen, BUFFER_BYTES if tuned else None)


def profile_environment(path: Path, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the variables that make Fast DDS load the profile at `path` and nothing else.

    A value of FASTDDS_BUILTIN_TRANSPORTS beside them changes nothing. Humble knows no range: ROS_LOCALHOST_ONLY is 0 there.

    Raises:
        OptionError: the user has a profile file already.
    """
    for name in PROFILE_VARIABLES:
        if environment.get(name):
            raise OptionError(
                f"{name} names a profile already, and Fast DDS loads one: set the transports there, or unset it and "
                "leave them to --transport and --tuned"
            )
    return {**RANGE, **dict.fromkeys(_read_variables(), str(path))}


def _read_variables() -> tuple[str, ...]:
    """Return the variables of the installed Fast DDS: 3 warns of the older one, and loads the same profile twice."""
    return PROFILE_VARIABLES if package_version("fastdds") is None else PROFILE_VARIABLES[1:]


@contextmanager
def written_profile(text: str) -> Iterator[Path]:
    """Give the path of a file with the profile, which is removed behind the block."""
    descriptor, name = tempfile.mkstemp(prefix="dds-trace-fastdds-", suffix=".xml")
    path = Path(name)
    try:
        with os.fdopen(descriptor, "w") as file:
            file.write(text)
        yield path
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def loaded_profile(text: str) -> Iterator[Path]:
    """Have the first participant that this process makes within the block load the profile.

    The environment is as before behind the block, so that no child process inherits the profile; Fast DDS keeps it for
    every later participant of this process.

    Raises:
        OptionError: the user has a profile file already.
    """
    with written_profile(text) as path:
        ours = profile_environment(path)
        before = {name: os.environ.get(name) for name in ours}
        os.environ.update(ours)
        try:
            yield path
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


_loaded: list[str | None] = []
"""Profile of the first node on Fast DDS that this process made for this machine alone, None for ROS 2's own; empty before."""


@contextmanager
def applied_transport(options: NodeOptions, rmw: str) -> Iterator[dict[str, str]]:
    """Have the node that is made within the block use the transport and the tuning of its options.

    Args:
        options: options of the node.
        rmw: identifier of the running ROS middleware.

    Yields:
        Settings of the session that tell how.

    Raises:
        OptionError: the middleware is not Fast DDS, no settings for large messages are known for the transport, the user
            has a profile file, or an earlier node of this process has other transports.
    """
    is_fastdds = ros_middleware(rmw).vendor == "fastdds"
    if not is_fastdds or options.discovery is not Discovery.LOCALHOST:
        set_transport(options, rmw)
        yield {}
        return
    text = asked_profile(options.transport, tuned=options.tuned)
    if _loaded and _loaded[0] != text:
        raise OptionError(
            "Fast DDS takes its transports once for each process, and an earlier node of this one has others: give both "
            "nodes the same transport and tuning, or each a process of its own"
        )
    if text is None:
        _loaded[:] = [text]
        yield {}
        return
    with loaded_profile(text):
        _loaded[:] = [text]
        yield {"profile": "written by dds-trace for this machine alone"}
