"""Fast DDS profiles of our own: for `--tuned`, and for ROS 2's LOCALHOST range (docs/reference/middlewares.md).

In that range rmw_fastrtps adds shared memory and UDP to the default profile (rmw_fastrtps_shared_cpp/src/participant.cpp). So we
set the range SYSTEM_DEFAULT and load a profile that does the same: sockets on 127.0.0.1 only, no multicast beyond it, unicast
search for participants. Fast DDS loads one profile file in each process, with its first participant.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

from dds_trace.base.errors import BackendUnavailableError, OptionError

from ...applied.vendors import BUFFER_BYTES, ros_middleware
from ...choices import Discovery, Transport
from ..node import NodeOptions
from ..sizes import VENDORS_SIZES, Sizes
from .installation import NO_TUNING, fast_dds, set_transport

Settings: TypeAlias = "dict[str, Any]"
"""Names of a configuration as they nest; an XML tag may carry attributes, and a list repeats it."""

RANGE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
"""Leaves discovery to the profile; ROS_STATIC_PEERS is ignored."""

MAX_PEERS = 32
"""Participants of one domain that are looked for on this machine, as in rmw_fastrtps's LOCALHOST range."""

_UDP, _NETWORK_UDP, _SHM, _TCP = "dds_trace_udp", "dds_trace_network_udp", "dds_trace_shm", "dds_trace_tcp"

_LOOPBACK = {"interfaceWhiteList": {"address": "127.0.0.1"}}

# An empty locator is the well-known unicast port, and keeps Fast DDS from opening its multicast one.
_UNICAST_DISCOVERY = {
    "builtin": {
        "metatrafficUnicastLocatorList": {"locator": ""},
        "initialPeersList": {"locator": {"udpv4": {"address": "127.0.0.1"}}},
    }
}

# LARGE_DATA looks for participants by multicast and for endpoints over TCP; the whitelist keeps both on loopback.
_MULTICAST = {"locator": {"udpv4": {"address": "239.255.0.1"}}}
_LARGE_DATA_DISCOVERY = {
    "builtin": {
        "metatrafficUnicastLocatorList": {
            "locator": {"tcpv4": {"physical_port": 0, "port": 0, "address": "0.0.0.0"}}  # noqa: S104 - of the peer's port
        },
        "metatrafficMulticastLocatorList": _MULTICAST,
        "initialPeersList": _MULTICAST,
    }
}

_LAYOUTS: dict[Transport, tuple[tuple[str, ...], Settings]] = {
    Transport.UDP: ((_UDP,), _UNICAST_DISCOVERY),
    Transport.SHM: ((_SHM,), {}),
    Transport.LARGE_DATA: ((_SHM, _TCP, _UDP), _LARGE_DATA_DISCOVERY),
}


def xml_text(title: str, settings: Settings) -> str:
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<!-- Written by dds-trace: {title}. -->\n{_tags(settings, "")}'


def _tags(settings: Settings, indent: str) -> str:
    lines = []
    for tag, values in settings.items():
        for value in values if isinstance(values, list) else [values]:
            content = f"\n{_tags(value, indent + '  ')}{indent}" if isinstance(value, dict) else value
            lines.append(f"{indent}<{tag}>{content}</{tag.partition(' ')[0]}>\n")
    return "".join(lines)


def profile_xml(
    title: str,
    transports: Mapping[str, Settings],
    rtps: Settings,
    further: Settings | None = None,
    participants: Mapping[str, Settings] | None = None,
) -> str:
    """Return a profile file in which the participants, by name, use these transports only.

    By default there is one participant, for all domains.
    """
    used = {"userTransports": {"transport_id": list(transports)}, "useBuiltinTransports": "false", **rtps}
    descriptors = [{"transport_id": name, **values} for name, values in transports.items()]
    profiles: Settings = {"transport_descriptors": {"transport_descriptor": descriptors}}
    for name, domain in (participants or {"dds_trace": {}}).items():
        default = "" if domain else ' is_default_profile="true"'
        profiles[f'participant profile_name="{name}"{default}'] = {**domain, "rtps": used}
    namespace = "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"
    return xml_text(title, {f'dds xmlns="{namespace}"': {"profiles": {**profiles, **(further or {})}}})


def localhost_profile(transport: Transport, buffer_bytes: int | None = None) -> str:
    if transport not in _LAYOUTS:
        raise OptionError(f"-o transport={transport.value}: ROS 2's own LOCALHOST range does that")
    if buffer_bytes is not None and transport is not Transport.UDP:
        raise OptionError(NO_TUNING.format(transport.value))
    names, discovery = _LAYOUTS[transport]
    return profile_xml(f"{transport.value} on this machine only", _transports(names, Sizes(buffer_bytes)), discovery)


def tuned_participants(names: Mapping[str, int], *, is_local: bool) -> str:
    transports, discovery = _LAYOUTS[Transport.UDP] if is_local else ((_NETWORK_UDP,), {})
    participants = {name: {"domainId": domain_id} for name, domain_id in names.items()}
    return profile_xml("tuned udp", _transports(transports, Sizes(BUFFER_BYTES)), discovery, participants=participants)


def _transports(names: Sequence[str], sizes: Sizes) -> dict[str, Settings]:
    buffers = {"receiveBufferSize": sizes.buffer, "maxMessageSize": sizes.fragment}
    udp = {"type": "UDPv4", **{name: size for name, size in buffers.items() if size is not None}}
    tcp = {"listening_ports": {"port": 0}, "calculate_crc": "false", "check_crc": "false", "enable_tcp_nodelay": "true"}
    descriptors: dict[str, Settings] = {
        _SHM: {
            "type": "SHM",
            **(fast_dds().large_data if _TCP in names else {}),
            **({} if sizes.segment is None else {"segment_size": sizes.segment}),
        },
        _TCP: {"type": "TCPv4", **_LOOPBACK, **tcp},  # as Fast DDS sets up TCP for LARGE_DATA
        _UDP: {**udp, **_LOOPBACK, "maxInitialPeersRange": MAX_PEERS},
        _NETWORK_UDP: udp,
    }
    return {name: descriptors[name] for name in names}


_SIZED = {Transport.DEFAULT: (_SHM, _UDP), Transport.UDP: (_UDP,), Transport.SHM: (_SHM,)}
"""Transports with sizes of their own; the default is what rmw_fastrtps sets up."""


def requested_profile(
    transport: Transport, *, tuned: bool, is_local: bool = True, sizes: Sizes = VENDORS_SIZES
) -> str | None:
    if any(sizes):
        chosen = Transport.UDP if tuned and transport is Transport.DEFAULT else transport
        names = [name if is_local or name != _UDP else _NETWORK_UDP for name in _SIZED[chosen]]
        discovery: Settings = _UNICAST_DISCOVERY if is_local and _UDP in names else {}
        if tuned and sizes.buffer is None:
            sizes = sizes._replace(buffer=BUFFER_BYTES)
        return profile_xml(f"{chosen.value} of other sizes", _transports(names, sizes), discovery)
    if not is_local:
        is_udp = transport in (Transport.DEFAULT, Transport.UDP)
        tuned_udp = _transports((_NETWORK_UDP,), Sizes(BUFFER_BYTES))
        return profile_xml("tuned udp", tuned_udp, {}) if tuned and is_udp else None
    if transport is Transport.DEFAULT and not tuned:
        return None
    # Tuning enlarges the buffers of UDP sockets.
    chosen = Transport.UDP if transport is Transport.DEFAULT else transport
    return localhost_profile(chosen, BUFFER_BYTES if tuned else None)


def profile_environment(
    path: Path, environment: Mapping[str, str] = os.environ, *, is_local: bool = True
) -> dict[str, str]:
    for name in fast_dds().profile_variables:
        if environment.get(name):
            raise OptionError(
                f"{name} already names a profile, and Fast DDS only loads one: set the transports there, or unset it to use "
                "-o transport and --tuned"
            )
    return {**(RANGE if is_local else {}), fast_dds().profile_variables[0]: str(path)}


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


_SENDS = (
    ("Publisher", "publish", "rcl_publish"),
    ("Client", "send_request", "rcl_send_request"),
    ("ActionClient", "send_goal_request", "rcl_action_send_goal_request"),
    ("ActionClient", "send_result_request", "rcl_action_send_result_request"),
    ("ActionServer", "publish_feedback", "rcl_action_publish_feedback"),
    ("ActionServer", "send_goal_response", "rcl_action_send_goal_response"),
    ("ActionServer", "send_result_response", "rcl_action_send_result_response"),
    ("Service", "service_send_response", "rcl_send_response"),
)
"""Class and method of rclpy's binding, and its function of rcl."""


def uses_tcp(options: NodeOptions) -> bool:
    return options.transport is Transport.LARGE_DATA or "LARGE_DATA" in os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", "")


def send_unlocked() -> None:
    """Have this process send without the interpreter's lock.

    rclpy keeps it until a message is sent: not even Ctrl-C ends a process that sends into a full connection.
    """
    binding = import_module("rclpy.impl.implementation_singleton").rclpy_implementation
    for kind, method, function in _SENDS:
        setattr(getattr(binding, kind), method, _sending(function))
    binding.Publisher.publish_raw = _publish_raw


BLOCKED_S = 0.05
"""Half of `max_blocking_time` of Fast DDS: a send that fails sooner has another cause than a full history."""


def send_when_free(send: Callable[[], object]) -> None:
    """Send until a writer with keep_all has room: rclpy raises when it has waited for `max_blocking_time`."""
    while True:
        start_s = time.monotonic()
        try:
            send()
        except (RuntimeError, BackendUnavailableError) as err:
            if time.monotonic() - start_s < BLOCKED_S:
                raise BackendUnavailableError(f"ROS 2 cannot send a message: {str(err).splitlines()[0]}") from err
        else:
            return


def _send(function: str, entity: Any, *arguments: Any) -> None:
    with entity:
        status = _function_of_rcl(function)(ctypes.c_void_p(entity.pointer), *arguments)
    if status not in (0, 2):  # RCL_RET_TIMEOUT: the client left
        raise BackendUnavailableError(f"ROS 2 cannot send a message ({function}: status {status})")


@cache
def _function_of_rcl(name: str) -> Any:
    return ctypes.CDLL("librcl_action.so" if name.startswith("rcl_action") else "librcl.so")[name]


def _sending(function: str) -> Callable[..., int]:
    def send(entity: Any, message: Any, other: Any = None) -> int:
        if other is not None and function.startswith("rcl_action"):  # the header of the request comes first
            message, other = other, message
        create, convert, destroy = _conversion_of(message.__class__)
        number, converted = ctypes.c_int64(), ctypes.c_void_p(create())
        arguments: tuple[Any, Any] = converted, None if "publish" in function else ctypes.byref(number)
        if other is not None:  # pybind11 has the address of a C structure first in its object
            arguments = ctypes.c_void_p.from_address(id(other) + object.__basicsize__), converted
        try:
            convert(message, converted)
            _send(function, entity, *arguments)
        finally:
            destroy(converted)
        return number.value

    return send


def _publish_raw(publisher: Any, message: bytes | bytearray) -> None:
    size = len(message)
    data = (ctypes.c_char * size).from_buffer(message if isinstance(message, bytearray) else bytearray(message))
    # `rcl_serialized_message_t` of rcl/types.h: buffer, length, capacity, unused allocator
    serialized = (ctypes.c_size_t * 8)(ctypes.addressof(data), size, size)
    _send("rcl_publish_serialized_message", publisher, ctypes.byref(serialized), None)


@cache
def _conversion_of(message_class: type) -> list[Any]:
    """Return what creates, fills and destroys a message of this class in C."""
    prototype = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)
    pointer_of = prototype(("PyCapsule_GetPointer", ctypes.pythonapi))
    forms = {
        "_CREATE_ROS_MESSAGE": ctypes.PYFUNCTYPE(ctypes.c_void_p),
        "_CONVERT_FROM_PY": ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p),
        "_DESTROY_ROS_MESSAGE": ctypes.PYFUNCTYPE(None, ctypes.c_void_p),
    }
    return [form(pointer_of(getattr(type(message_class), name), None)) for name, form in forms.items()]
