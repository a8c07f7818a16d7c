"""What each middleware leaves behind in a process, and what an asked transport means for it: one table.

Found by experiment with Fast DDS 2.14.5 (rmw_fastrtps of Jazzy), Cyclone DDS 11.0.1 and zenoh 1.10; Fast DDS 3 differs in
the names of its files alone (`fastdds_` for `fastrtps_`). Connext was not tried (no licence), so nothing is expected of it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

SEGMENT, PORT = "segment", "port"
"""Roles of a shared-memory file: payloads lie in a segment; a port is the queue of one receiver."""


@dataclass(frozen=True, slots=True)
class TransportFacts:
    """What must be seen in a process that really uses a transport.

    Attributes:
        label: the transport in a sentence.
        protocol: `udp` or `tcp` if at least one such socket is open, None if none need be.
        shared_memory: True if the middleware's shared memory is mapped, False if it is not, None if both are honest.
    """

    label: str
    protocol: str | None = None
    shared_memory: bool | None = None


@dataclass(frozen=True, slots=True)
class TunedFacts:
    """Which buffers `--tuned` enlarges.

    Attributes:
        receive_bytes: receive buffer that the program sets, 0 if it sets none.
        send_bytes: send buffer that the program sets, 0 if it sets none.
        transport: transport that tuning implies where none is asked for.
    """

    receive_bytes: int = 0
    send_bytes: int = 0
    transport: str = "default"


@dataclass(frozen=True, slots=True)
class VendorFacts:
    """One middleware.

    Attributes:
        vendor: as in a session (`fastdds`, `cyclonedds`, `connext`, `zenoh`, `socket`).
        memory: role -> pattern of the names of its shared-memory files.
        locks_own_files: holds a lock file `NAME_el` open for each file of its own while it uses it.
        libraries: pattern of a library's file name -> Python distribution that may carry it, empty if none does.
        transports: transport -> what must be seen.
        shared_memory: transport -> whether it asks for shared memory or for none, where a link is open either way.
        tuned: what `--tuned` sets.
    """

    vendor: str
    memory: Mapping[str, re.Pattern[str]] = field(default_factory=dict)
    locks_own_files: bool = False
    libraries: Mapping[str, str] = field(default_factory=dict)
    transports: Mapping[str, TransportFacts] = field(default_factory=dict)
    shared_memory: Mapping[str, bool] = field(default_factory=dict)
    tuned: TunedFacts = TunedFacts()


BUFFER_BYTES = 4_000_000
"""Socket buffer of every vendor's `--tuned`; `recorder.backends.socket.udp.TUNED_BUFFER_BYTES` is the same number."""

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
                r"libfast(rtps|dds)\.so": "ros-fastrtps",
                r"librmw_fastrtps_cpp\.so": "ros-rmw-fastrtps-cpp",
            },
            transports={
                "udp": UDP,
                "shm": TransportFacts("shared memory", shared_memory=True),
                # On one machine Fast DDS carries its payload through shared memory although TCP is open.
                "large-data": TransportFacts("LARGE_DATA", "tcp"),
            },
            tuned=TunedFacts(BUFFER_BYTES, BUFFER_BYTES, transport="udp"),
        ),
        VendorFacts(
            "cyclonedds",
            memory={SEGMENT: re.compile(r"(iceoryx|iox)\w*")},  # its only shared memory is iceoryx's
            libraries={r"libddsc": "cyclonedds", r"librmw_cyclonedds_cpp\.so": "", r"libiceoryx": ""},
            # Its send buffer stays the system's: SocketSendBufferSize is not among the tuned settings.
            tuned=TunedFacts(BUFFER_BYTES),
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
        ),
        VendorFacts(
            "socket",
            transports={
                "default": TransportFacts("TCP", "tcp"),
                "udp": UDP,
            },
            # Buffers of UDP sockets alone are compared: those of TCP the kernel sizes itself.
            tuned=TunedFacts(BUFFER_BYTES, BUFFER_BYTES),
        ),
    )
}

UNKNOWN = VendorFacts("")
"""Facts of a middleware that the table does not know: nothing must be seen."""


def vendor_facts(vendor: str) -> VendorFacts:
    """Return the facts of a vendor, `UNKNOWN` for one that is not in the table."""
    return VENDORS.get(vendor, UNKNOWN)


def memory_owner(name: str) -> tuple[str, str] | None:
    """Return vendor and role of a shared-memory file by its name, None if no middleware of the table made it."""
    for facts in VENDORS.values():
        for role, pattern in facts.memory.items():
            if pattern.fullmatch(name):
                return facts.vendor, role
    return None
