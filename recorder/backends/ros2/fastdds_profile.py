"""Fast DDS profiles of our own: for `--tuned`, and for ROS 2's LOCALHOST range, where FASTDDS_BUILTIN_TRANSPORTS changes nothing.

`--tuned` enlarges receive buffers only, which that variable cannot do: with a large send buffer a message overflows the queue of
an interface that is slower than its burst.

In that range rmw_fastrtps adds shared memory and UDP to the default profile
(rmw_fastrtps_shared_cpp/src/participant.cpp), so nothing removes shared memory. Instead we set the range SYSTEM_DEFAULT
and load a profile that does the same: sockets on 127.0.0.1 only, no multicast beyond it, unicast search for
participants.

Fast DDS loads one profile file in each process, with its first participant. So all nodes of a process have the same
transports, and the options are refused if the user has a profile.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dds_trace.base.errors import BackendUnavailableError, OptionError

from ...applied.asked import PROFILE_VARIABLES
from ...applied.vendors import BUFFER_BYTES, ros_middleware
from ...choices import Discovery, Transport
from ..sizes import VENDORS_SIZES, Sizes
from .installation import NO_TUNING, package_version, set_transport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from ..node import NodeOptions

RANGE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
"""Leaves discovery to the profile; ROS_STATIC_PEERS is ignored."""

MAX_PEERS = 32
"""Participants of one domain that are looked for on this machine, as in rmw_fastrtps's LOCALHOST range."""

_UDP, _NETWORK_UDP, _SHM, _TCP = "dds_trace_udp", "dds_trace_network_udp", "dds_trace_shm", "dds_trace_tcp"

_WHITELIST = "        <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>\n"

_DESCRIPTORS = {
    _SHM: "        <type>SHM</type>\n{segment}",
    # As Fast DDS sets up TCP for LARGE_DATA.
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
    _NETWORK_UDP: "        <type>UDPv4</type>\n{buffers}",
}

_BUFFERS = "        <receiveBufferSize>{bytes}</receiveBufferSize>\n"
_FRAGMENTS = "        <maxMessageSize>{bytes}</maxMessageSize>\n"
_SEGMENT = "        <segment_size>{bytes}</segment_size>\n"

# An empty locator is the well-known unicast port, and keeps Fast DDS from opening its multicast one.
_UNICAST_DISCOVERY = """\
        <builtin>
          <metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>
          <initialPeersList>
            <locator><udpv4><address>127.0.0.1</address></udpv4></locator>
          </initialPeersList>
        </builtin>
"""

# LARGE_DATA looks for participants by multicast and for endpoints over TCP; the whitelist keeps both on loopback.
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
<!-- Written by dds-trace: {title}. -->
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
{descriptors}    </transport_descriptors>
{participants}  </profiles>
</dds>
"""

_PARTICIPANT = """\
    <participant {attributes}>
{domain}      <rtps>
        <userTransports>
{transports}        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
{discovery}      </rtps>
    </participant>
"""

_DEFAULT_PARTICIPANT = ('profile_name="dds_trace" is_default_profile="true"', "")


_LAYOUTS = {
    Transport.UDP: ((_UDP,), _UNICAST_DISCOVERY),
    Transport.SHM: ((_SHM,), ""),
    Transport.LARGE_DATA: ((_SHM, _TCP, _UDP), _LARGE_DATA_DISCOVERY),
}


def localhost_profile(transport: Transport, buffer_bytes: int | None = None) -> str:
    if transport not in _LAYOUTS:
        raise OptionError(f"--transport {transport.value}: ROS 2's own LOCALHOST range does that")
    if buffer_bytes is not None and transport is not Transport.UDP:
        raise OptionError(NO_TUNING.format(transport.value))
    transports, discovery = _LAYOUTS[transport]
    return _profile(f"{transport.value} on this machine only", transports, discovery, Sizes(buffer_bytes))


def _profile(
    title: str,
    transports: tuple[str, ...],
    discovery: str,
    sizes: Sizes,
    participants: Sequence[tuple[str, str]] = (_DEFAULT_PARTICIPANT,),
) -> str:
    return _PROFILE.format(
        title=title,
        descriptors="".join(_descriptor(name, sizes) for name in transports),
        participants="".join(
            _PARTICIPANT.format(
                attributes=attributes,
                domain=domain,
                transports="".join(f"          <transport_id>{name}</transport_id>\n" for name in transports),
                discovery=discovery,
            )
            for attributes, domain in participants
        ),
    )


def tuned_participants(names: Mapping[str, int], *, is_local: bool) -> str:
    transports, discovery = _LAYOUTS[Transport.UDP] if is_local else ((_NETWORK_UDP,), "")
    participants = [
        (f'profile_name="{name}"', f"      <domainId>{domain_id}</domainId>\n") for name, domain_id in names.items()
    ]
    return _profile("tuned udp", transports, discovery, Sizes(BUFFER_BYTES), participants)


def _descriptor(name: str, sizes: Sizes) -> str:
    buffer, segment, fragment = (
        "" if size is None else text.format(bytes=size)
        for size, text in zip(sizes, (_BUFFERS, _SEGMENT, _FRAGMENTS), strict=True)
    )
    body = _DESCRIPTORS[name].format(buffers=buffer + fragment, segment=segment)
    return (
        "      <transport_descriptor>\n"
        f"        <transport_id>{name}</transport_id>\n"
        f"{body}"
        "      </transport_descriptor>\n"
    )


_SIZED = {Transport.DEFAULT: (_SHM, _UDP), Transport.UDP: (_UDP,), Transport.SHM: (_SHM,)}
"""Transports with sizes of their own; the default is what rmw_fastrtps sets up."""


def requested_profile(
    transport: Transport, *, tuned: bool, is_local: bool = True, sizes: Sizes = VENDORS_SIZES
) -> str | None:
    if any(sizes):
        chosen = Transport.UDP if tuned and transport is Transport.DEFAULT else transport
        names = [name if is_local or name != _UDP else _NETWORK_UDP for name in _SIZED[chosen]]
        discovery = _UNICAST_DISCOVERY if is_local and _UDP in names else ""
        if tuned and sizes.buffer is None:
            sizes = sizes._replace(buffer=BUFFER_BYTES)
        return _profile(f"{chosen.value} of other sizes", tuple(names), discovery, sizes)
    if not is_local:
        is_udp = transport in (Transport.DEFAULT, Transport.UDP)
        return _profile("tuned udp", (_NETWORK_UDP,), "", Sizes(BUFFER_BYTES)) if tuned and is_udp else None
    if transport is Transport.DEFAULT and not tuned:
        return None
    # Tuning enlarges the buffers of UDP sockets.
    chosen = Transport.UDP if transport is Transport.DEFAULT else transport
    return localhost_profile(chosen, BUFFER_BYTES if tuned else None)


def profile_environment(
    path: Path, environment: Mapping[str, str] = os.environ, *, is_local: bool = True
) -> dict[str, str]:
    for name in PROFILE_VARIABLES:
        if environment.get(name):
            raise OptionError(
                f"{name} already names a profile, and Fast DDS only loads one: set the transports there, or unset it to use "
                "--transport and --tuned"
            )
    # Fast DDS 3 warns of the older variable, and loads the same profile twice.
    variables = PROFILE_VARIABLES if package_version("fastdds") is None else PROFILE_VARIABLES[1:]
    return {**(RANGE if is_local else {}), **dict.fromkeys(variables, str(path))}


@contextmanager
def written_profile(text: str) -> Iterator[Path]:
    with tempfile.NamedTemporaryFile("w", prefix="dds-trace-fastdds-", suffix=".xml") as file:
        file.write(text)
        file.flush()
        yield Path(file.name)


@contextmanager
def loaded_profile(text: str, *, is_local: bool = True) -> Iterator[Path]:
    """Have this process's first participant load the profile; no child process inherits it."""
    with written_profile(text) as path:
        variables = profile_environment(path, is_local=is_local)
        previous = {name: os.environ.get(name) for name in variables}
        os.environ.update(variables)
        try:
            yield path
        finally:
            for name, value in previous.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


_loaded: list[str | None] = []
"""Profile of this process's first Fast DDS node, None for ROS 2's own."""


@contextmanager
def applied_transport(options: NodeOptions, rmw: str) -> Iterator[dict[str, str]]:
    is_local = options.discovery is Discovery.LOCALHOST
    is_fastdds = ros_middleware(rmw).vendor == "fastdds"
    text = None
    if is_fastdds:
        text = requested_profile(options.transport, tuned=options.tuned, is_local=is_local, sizes=options.sizes)
    if not is_fastdds or (text is None and not is_local):
        set_transport(options, rmw)
    if not is_fastdds:
        yield {}
        return
    if _loaded and _loaded[0] != text:
        raise OptionError(
            "Fast DDS sets its transports once in each process, and an earlier node of this one has others: give both "
            "nodes the same transport and tuning, or each a process of its own"
        )
    where = " for this machine only" if is_local else ""
    with nullcontext() if text is None else loaded_profile(text, is_local=is_local):
        _loaded[:] = [text]
        yield {} if text is None else {"profile": f"written by dds-trace{where}"}


class _SerializedMessage(ctypes.Structure):
    """`rcl_serialized_message_t` of rcl/types.h; its allocator is not used."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("buffer_length", ctypes.c_size_t),
        ("buffer_capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


def publish_unlocked(handle: Any) -> Callable[[bytes | bytearray], None]:
    """Return the function that publishes a serialized message; rclpy's own keeps the interpreter's lock until it is sent."""
    publish = ctypes.CDLL("librcl.so").rcl_publish_serialized_message
    publish.argtypes = (ctypes.c_void_p, ctypes.POINTER(_SerializedMessage), ctypes.c_void_p)

    def send(message: bytes | bytearray) -> None:
        size = len(message)
        data = (ctypes.c_char * size).from_buffer(message if isinstance(message, bytearray) else bytearray(message))
        serialized = _SerializedMessage(ctypes.addressof(data), size, size)
        with handle:
            status = publish(handle.pointer, ctypes.byref(serialized), None)
        if status:
            raise BackendUnavailableError(f"ROS 2 cannot publish {size} bytes (status {status})")

    return send
