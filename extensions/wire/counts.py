"""Counts of one run on the wire, and of its TCP connections as the kernel reports them."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from dds_trace.base.errors import OptionError
from dds_trace.base.records import to_json
from dds_trace.recorder.kernel.sockets import (
    FAMILIES,
    INFO,
    NETLINK_SOCK_DIAG,
    RECEIVE_BYTES,
    DiagError,
    DiagSocket,
    dump_sockets,
    netlink_messages,
    parse_socket,
    tcp_info_fields,
)

from .classes import WireClass
from .format import AGAIN_CLASSES, DISCOVERY_CLASSES, Direction
from .frames import Frame
from .messages import RepeatCount


@dataclass(slots=True)
class ClassCount:
    """Traffic of a `WireClass` in one direction (docs/reference/wire.md); a DATA_FRAG with a repeated fragment is repeated."""

    name: str
    direction: str
    packets: int = 0
    bytes: int = 0
    submessages: int = 0
    fragments: int = 0
    ip_fragments: int = 0


class _ClassCounts(dict[tuple[WireClass, Direction], ClassCount]):
    def __missing__(self, key: tuple[WireClass, Direction]) -> ClassCount:
        self[key] = count = ClassCount(key[0].value, key[1].name.lower())
        return count


@dataclass(slots=True)
class RunTally:
    """Counters of a run; frames of other domains are only in `foreign_packets`."""

    classes: _ClassCounts = field(default_factory=_ClassCounts)
    foreign_packets: int = 0
    unseen_headers: int = 0
    requests: int = 0
    tcp_again_bytes: int = 0
    heartbeat_gaps_ns: list[int] = field(default_factory=list)
    packets: int = 0

    @property
    def heartbeat_gap_p50_ns(self) -> float | None:
        return median(self.heartbeat_gaps_ns) if self.heartbeat_gaps_ns else None

    def count_frame(self, frame: Frame, kind: WireClass, direction: Direction) -> None:
        tally = self.classes[kind, direction]
        tally.packets += 1
        tally.bytes += frame.wire_bytes
        tally.ip_fragments += bool(frame.fragment_offset or frame.more_fragments)

    def move_bytes(self, bytes_of: Counter[WireClass], principal: WireClass, direction: Direction) -> None:
        for kind, size in bytes_of.items():
            if kind is not principal:
                self.classes[kind, direction].bytes += size
                self.classes[principal, direction].bytes -= size


_IP_NAMES = {
    # name -> that in /proc/net/snmp
    "reassembly_requested": "ReasmReqds",
    "reassembly_ok": "ReasmOKs",
    "reassembly_failed": "ReasmFails",
    "reassembly_timeout": "ReasmTimeout",
    "datagrams_fragmented": "FragOKs",
    "fragmentation_failed": "FragFails",
    "fragments_created": "FragCreates",
    "udp_receive_buffer_full": "RcvbufErrors",
    "udp_in_errors": "InErrors",
}


def ip_counts(totals: Mapping[str, int], before: Mapping[str, int]) -> dict[str, int]:
    return {name: totals.get(kernels, 0) - before.get(kernels, 0) for name, kernels in _IP_NAMES.items()}


_TCP_DESTROYED_GROUP = 1 << 0  # SKNLGRP_INET_TCP_DESTROY as a bit of the address
_CONNECTED_STATES = 0xFFF & ~(1 << 6)  # not TCP_TIME_WAIT


@dataclass(frozen=True, slots=True)
class TcpConnection:
    """One end of a connection, without addresses, which may identify a device; counters since it opened, or of a run."""

    local_port: int
    remote_port: int
    retransmitted_segments: int = 0
    bytes_retransmitted: int = 0
    bytes_sent: int = 0
    segments_out: int = 0
    segments_in: int = 0
    segment_bytes: int = 0
    rtt_us: int = 0
    rtt_variance_us: int = 0
    rtt_min_us: int = 0
    congestion_window: int = 0


TCP_COUNTERS = ("retransmitted_segments", "segments_out", "segments_in", "bytes_sent", "bytes_retransmitted")
"""Fields of a `TcpConnection` that only grow."""


def parse_tcp_info(info: bytes, local_port: int, remote_port: int) -> TcpConnection:
    return TcpConnection(local_port, remote_port, **tcp_info_fields(info, TcpConnection))


def read_connections(ports: Sequence[tuple[int, int]]) -> dict[int, TcpConnection]:
    """Return, by the kernel's socket cookie, this network namespace's connections with a port in a range (both ends count)."""
    sockets: list[DiagSocket] = []
    for family in FAMILIES.values():
        with suppress(DiagError):  # a kernel without this family
            sockets += dump_sockets(family, socket.IPPROTO_TCP, _CONNECTED_STATES)
    return _with_ports(sockets, ports)


class ClosedConnections:
    """Listener for connections that end: one that is read once a second has sent more when it ends. An `OptionError` without sock_diag."""

    def __init__(self, ports: Sequence[tuple[int, int]]) -> None:
        self._ports = ports
        try:
            self._link = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, NETLINK_SOCK_DIAG)
        except OSError as err:
            raise OptionError(f"--wire: this kernel does not report TCP connections: {err.strerror}") from err
        self._link.setblocking(False)
        self._link.bind((0, _TCP_DESTROYED_GROUP))

    def read(self) -> dict[int, TcpConnection]:
        ended: dict[int, TcpConnection] = {}
        # BlockingIOError: no more. ENOBUFS: so many ended at once that some are missing; their last reading counts.
        with suppress(OSError):
            while True:
                messages = netlink_messages(self._link.recv(RECEIVE_BYTES))
                ended |= _with_ports([parse_socket(body) for _, body in messages], self._ports)
        return ended

    def fileno(self) -> int:
        return self._link.fileno()

    def close(self) -> None:
        self._link.close()


def _with_ports(sockets: Iterable[DiagSocket], ports: Sequence[tuple[int, int]]) -> dict[int, TcpConnection]:
    return {
        opened.cookie: parse_tcp_info(opened.attributes.get(INFO, b""), opened.local[1], opened.remote[1])
        for opened in sockets
        if opened.remote[1]  # a listening socket has none
        and any(first <= end[1] <= last for first, last in ports for end in (opened.local, opened.remote))
    }


@dataclass(frozen=True, slots=True)
class InterfaceCount:
    name: str
    sent_bytes: int = 0
    sent_packets: int = 0
    received_bytes: int = 0
    received_packets: int = 0


@dataclass(frozen=True, slots=True)
class WireCounts:
    """Counts of one run on the wire, seen from one side: the fields of docs/reference/wire.md."""

    run_id: str = ""
    interfaces: tuple[str, ...] = ()
    begin_ns: int = 0
    end_ns: int = 0
    classes: tuple[ClassCount, ...] = ()
    repeats: tuple[RepeatCount, ...] = ()
    messages: int = 0
    sample_bytes: int = 0
    requests: int = 0
    heartbeat_gap_p50_ns: float | None = None
    first_spdp_ns: int | None = None
    first_data_ns: int | None = None
    first_reply_ns: int | None = None
    ip: Mapping[str, int] = field(default_factory=lambda: ip_counts({}, {}))
    tcp: tuple[TcpConnection, ...] = ()
    tcp_again_bytes: int = 0
    interface_counts: tuple[InterfaceCount, ...] = ()
    foreign_packets: int = 0
    unseen_headers: int = 0
    unfollowed_datagrams: int = 0
    late_repeats: int = 0
    kernel_drops: int = 0
    kernel_freezes: int = 0
    packets: int = 0
    cpu_s: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether the kernel delivered every packet; if not, the counts are lower bounds and prove nothing."""
        return self.kernel_drops == 0

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.begin_ns) / 1e9

    @property
    def total_bytes(self) -> int:
        return sum(count.bytes for count in self.classes)

    @property
    def wire_bytes_per_sample_byte(self) -> float | None:
        return self.total_bytes / self.sample_bytes if self.sample_bytes else None

    @property
    def discovery_bytes(self) -> int:
        return self._bytes_of(DISCOVERY_CLASSES)

    @property
    def discovery_bytes_per_minute(self) -> float | None:
        """Bytes of SPDP, SEDP and liveliness a minute, both directions; None if no time passed."""
        return self.discovery_bytes * 60 / self.duration_s if self.duration_s else None

    @property
    def again_bytes_share(self) -> float | None:
        return self._bytes_of(AGAIN_CLASSES) / self.total_bytes if self.total_bytes else None

    @property
    def match_ns(self) -> int | None:
        if self.first_spdp_ns is None or self.first_reply_ns is None:
            return None
        return self.first_reply_ns - self.first_spdp_ns

    @property
    def packets_per_s(self) -> float | None:
        return self.packets / self.duration_s if self.duration_s else None

    def _bytes_of(self, names: frozenset[str]) -> int:
        return sum(count.bytes for count in self.classes if count.name in names)

    def to_dict(self) -> dict[str, Any]:
        derived = [name for name, value in vars(type(self)).items() if isinstance(value, property)]
        return {**to_json(self), **{name: getattr(self, name) for name in derived}}
