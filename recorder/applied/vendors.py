"""All facts about a vendor, in two tables: the middlewares, and the ROS 2 RMWs on top.

Determined with Fast DDS 2.14.5 and 3.2.3 (rmw_fastrtps of Jazzy and Kilted; how they differ is in `backends.ros2.installation`), Cyclone
DDS 11.0.1 and zenoh 1.10. Connext was not tried (no licence), so nothing is expected of it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

SEGMENT, PORT = "segment", "port"
"""Roles of a shared-memory file: a segment contains payloads; a port is the queue of one receiver."""


@dataclass(frozen=True, slots=True)
class TransportFacts:
    """What must be seen in a process that really uses a transport, which sentences call `label`.

    With a `protocol` at least one socket of it is open; `shared_memory` is mapped, or is not, or None if both are fine.
    """

    label: str
    protocol: str | None = None
    shared_memory: bool | None = None


@dataclass(frozen=True, slots=True)
class TunedFacts:
    """Receive buffer of sockets that `--tuned` sets (0: none), and the transport that it implies if none is requested."""

    receive_bytes: int = 0
    transport: str = "default"


@dataclass(frozen=True, slots=True)
class VendorFacts:
    """One middleware.

    Attributes:
        locks_own_files: locks a file `NAME_el` for each file of its own while it uses it.
        libraries: pattern of a library's file name -> Python distribution that may contain it, or empty.
        transports: transport -> what must be seen.
        shared_memory: transport -> whether it requests shared memory or none, if a link is open either way.
        builtin_transports: (transport, tuned) of its RMW -> FASTDDS_BUILTIN_TRANSPORTS, None for what the user has set.
        name_interface: the variable that names the only interface `{}`.
        tcp_has_both_buffers: whether `-o buffer` is of both directions of its TCP connections, which are read back then.
    """

    vendor: str
    memory: Mapping[str, re.Pattern[str]] = field(default_factory=dict)
    locks_own_files: bool = False
    libraries: Mapping[str, str] = field(default_factory=dict)
    transports: Mapping[str, TransportFacts] = field(default_factory=dict)
    shared_memory: Mapping[str, bool] = field(default_factory=dict)
    tuned: TunedFacts = TunedFacts()
    variables: tuple[str, ...] = ()
    builtin_transports: Mapping[tuple[str, bool], str | None] = field(default_factory=dict)
    tcp_has_both_buffers: bool = False
    name_interface: str = ""


BUFFER_BYTES = 4_000_000
"""Receive buffer of every vendor's `--tuned`."""

UDP = TransportFacts("UDP", "udp", shared_memory=False)

VENDORS: Mapping[str, VendorFacts] = {
    facts.vendor: facts
    for facts in (
        VendorFacts(
            "fastdds",
            memory={
                PORT: re.compile(r"(fastrtps|fastdds)_port\d+"),
                SEGMENT: re.compile(r"((fastrtps|fastdds)_[0-9a-f]{16}|fast_datasharing_.+)"),
            },
            locks_own_files=True,
            libraries={
                r"libfastrtps\.so": "ros-fastrtps",
                r"libfastdds\.so": "ros-fastdds",
                r"librmw_fastrtps_cpp\.so": "ros-rmw-fastrtps-cpp",
            },
            transports={
                "udp": UDP,
                "shm": TransportFacts("shared memory", shared_memory=True),
                # On one machine Fast DDS carries its payload through shared memory although TCP is open.
                "large-data": TransportFacts("LARGE_DATA", "tcp"),
            },
            tuned=TunedFacts(BUFFER_BYTES, transport="udp"),
            variables=("FASTDDS_BUILTIN_TRANSPORTS", "RMW_FASTRTPS_PUBLICATION_MODE", "RMW_FASTRTPS_USE_QOS_FROM_XML"),
            builtin_transports={
                ("default", False): None,
                ("udp", False): "UDPv4",
                ("shm", False): "SHM",
                ("large-data", False): "LARGE_DATA",
            },
        ),
        VendorFacts(
            "cyclonedds",
            memory={SEGMENT: re.compile(r"(iceoryx|iox)\w*")},  # its only shared memory is iceoryx's
            libraries={r"libddsc": "cyclonedds", r"librmw_cyclonedds_cpp\.so": "", r"libiceoryx": ""},
            tuned=TunedFacts(BUFFER_BYTES),
            name_interface=(
                'CYCLONEDDS_URI=\'<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="{}"/></Interfaces></General>'
                "</Domain></CycloneDDS>'"
            ),
        ),
        VendorFacts(
            "connext",
            memory={SEGMENT: re.compile(r"SYSV[0-9a-f]{8}")},  # System V segments, which have no file
            libraries={r"libnddsc(ore)?\.so": "rti.connext", r"librmw_connextdds\.so": ""},
        ),
        VendorFacts(
            "zenoh",
            # On one machine zenoh moves messages of 3 KB and more through these although its link is TCP.
            memory={SEGMENT: re.compile(r"\d+\.zenoh")},
            shared_memory={"shm": True, "tcp": False},
            libraries={r"(lib)?zenohc?\.": "eclipse-zenoh", r"librmw_zenoh_cpp\.so": ""},
            # The other variables are the backend's own, and recorded as hashes.
            variables=("ZENOH_ROUTER_CHECK_ATTEMPTS",),
            tcp_has_both_buffers=True,
        ),
        VendorFacts(
            "socket",
            transports={"default": TransportFacts("TCP", "tcp"), "udp": UDP},
            # The kernel sizes buffers of TCP itself.
            tuned=TunedFacts(BUFFER_BYTES),
            tcp_has_both_buffers=True,
        ),
    )
}

UNKNOWN = VendorFacts("")


def vendor_facts(vendor: str) -> VendorFacts:
    return VENDORS.get(vendor, UNKNOWN)


def memory_owner(name: str) -> tuple[str, str] | None:
    for facts in VENDORS.values():
        for role, pattern in facts.memory.items():
            if pattern.fullmatch(name):
                return facts.vendor, role
    return None


@dataclass(frozen=True, slots=True)
class RosMiddleware:
    """One middleware of ROS 2 (RMW); without `stamps_reception` its `received_timestamp` is the time of the take."""

    vendor: str
    label: str
    packages: tuple[str, ...]
    stamps_reception: bool = True
    has_durations: bool = True
    router: str = ""
    router_port: int = 0


ROS_MIDDLEWARES: Mapping[str, RosMiddleware] = {
    "rmw_fastrtps_cpp": RosMiddleware("fastdds", "Fast DDS", ("rmw_fastrtps_cpp",)),
    "rmw_fastrtps_dynamic_cpp": RosMiddleware("fastdds", "Fast DDS", ("rmw_fastrtps_dynamic_cpp",)),
    # Its source fills `received_timestamp` when the message is taken (a TODO in rmw_node.cpp, take_with_info).
    "rmw_cyclonedds_cpp": RosMiddleware(
        "cyclonedds", "Cyclone DDS", ("cyclonedds", "rmw_cyclonedds_cpp"), stamps_reception=False
    ),
    "rmw_connextdds": RosMiddleware("connext", "RTI Connext", ("rti_connext_dds_cmake_module", "rmw_connextdds")),
    # README and design.md: no multicast, sessions connect to a router at tcp/localhost:7447; no deadline or lifespan.
    "rmw_zenoh_cpp": RosMiddleware(
        "zenoh",
        "Zenoh",
        ("zenoh_cpp_vendor", "rmw_zenoh_cpp"),
        has_durations=False,
        router="rmw_zenohd",
        router_port=7447,
    ),
}
"""Identifier of an RMW -> its facts; any other one runs too, by its own name."""


def ros_middleware(rmw: str) -> RosMiddleware:
    name = rmw.removeprefix("rmw_").removesuffix("_cpp")
    return ROS_MIDDLEWARES.get(rmw, RosMiddleware(name, name, (rmw,)))
