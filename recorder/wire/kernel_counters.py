"""The kernel's own counters of this process's network namespace: IP fragments, UDP datagrams, interfaces."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_SNMP, _DEV = Path("/proc/net/snmp"), Path("/proc/net/dev")
_FIELDS = {
    "reassembly_requested": ("Ip", "ReasmReqds"),
    "reassembly_ok": ("Ip", "ReasmOKs"),
    "reassembly_failed": ("Ip", "ReasmFails"),
    "reassembly_timeout": ("Ip", "ReasmTimeout"),
    "datagrams_fragmented": ("Ip", "FragOKs"),
    "fragmentation_failed": ("Ip", "FragFails"),
    "fragments_created": ("Ip", "FragCreates"),
    "udp_receive_buffer_full": ("Udp", "RcvbufErrors"),
    "udp_in_errors": ("Udp", "InErrors"),
}


@dataclass(frozen=True, slots=True)
class IpCounts:
    """Kernel counters of a run, or since boot; of all programs in the network namespace.

    Attributes:
        reassembly_requested: IP fragments that arrived and needed others (ReasmReqds).
        reassembly_ok: datagrams put together (ReasmOKs).
        reassembly_failed: failures (ReasmFails): timeouts, no memory (`net.ipv4.ipfrag_high_thresh`), bad fragments.
        reassembly_timeout: datagrams given up after `net.ipv4.ipfrag_time` (ReasmTimeout).
        datagrams_fragmented: that were sent in fragments (FragOKs).
        fragmentation_failed: that must not be fragmented (FragFails).
        fragments_created: by this host (FragCreates).
        udp_receive_buffer_full: datagrams that found no room in their socket (RcvbufErrors).
        udp_in_errors: datagrams that were not delivered, for any reason (InErrors).
    """

    reassembly_requested: int = 0
    reassembly_ok: int = 0
    reassembly_failed: int = 0
    reassembly_timeout: int = 0
    datagrams_fragmented: int = 0
    fragmentation_failed: int = 0
    fragments_created: int = 0
    udp_receive_buffer_full: int = 0
    udp_in_errors: int = 0

    def since(self, before: IpCounts) -> IpCounts:
        """Return how much each counter grew."""
        return IpCounts(*(getattr(self, f.name) - getattr(before, f.name) for f in fields(self)))

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return asdict(self)

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> IpCounts:
        """Return the counters that a JSON object of `to_dict` holds; unknown fields are ignored, missing ones are 0."""
        return cls(**{name: int(found[name]) for name in cls.__slots__ if name in found})


def parse_snmp(text: str) -> IpCounts:
    """Return the counters in the text of `/proc/net/snmp`; one that this kernel does not have is 0."""
    tables: dict[str, dict[str, str]] = {}
    lines = text.splitlines()
    for names, values in zip(lines[::2], lines[1::2], strict=False):
        protocol, _, columns = names.partition(":")
        tables[protocol] = dict(zip(columns.split(), values.partition(":")[2].split(), strict=False))
    return IpCounts(
        **{field: int(tables.get(protocol, {}).get(name, 0)) for field, (protocol, name) in _FIELDS.items()}
    )


def read_ip_counts(path: Path = _SNMP) -> IpCounts:
    """Return the counters since boot of this process's network namespace."""
    return parse_snmp(path.read_text())


@dataclass(frozen=True, slots=True)
class InterfaceCount:
    """The interface's own counters (`/proc/net/dev`) over the run, of all traffic; bytes as its driver counts them.

    Attributes:
        name: of the interface.
        sent_bytes, sent_packets, received_bytes, received_packets: how much they grew.
    """

    name: str
    sent_bytes: int = 0
    sent_packets: int = 0
    received_bytes: int = 0
    received_packets: int = 0

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> InterfaceCount:
        """Return the counters that a JSON object of `WireCounts.to_dict` holds; unknown fields are ignored."""
        known = {name: found[name] for name in cls.__slots__ if name in found}
        return cls(**{"name": "", **known})


def parse_interfaces(text: str, names: Sequence[str]) -> tuple[InterfaceCount, ...]:
    """Return the counters of the named interfaces in the text of `/proc/net/dev`, in the order of the names."""
    rows = {}
    for line in text.splitlines()[2:]:
        name, _, numbers = line.partition(":")
        rows[name.strip()] = [int(number) for number in numbers.split()]
    return tuple(
        InterfaceCount(name, *(rows[name][column] for column in (8, 9, 0, 1)))
        for name in names
        if name in rows
    )


def read_interfaces(names: Sequence[str], path: Path = _DEV) -> tuple[InterfaceCount, ...]:
    """Return the counters since boot of the named interfaces."""
    return parse_interfaces(path.read_text(), names)


def interfaces_since(
    now: Sequence[InterfaceCount], before: Sequence[InterfaceCount]
) -> tuple[InterfaceCount, ...]:
    """Return how much the counters of each interface grew."""
    earlier = {count.name: count for count in before}
    return tuple(
        InterfaceCount(
            count.name,
            *(
                getattr(count, name) - getattr(earlier.get(count.name, InterfaceCount("")), name)
                for name in ("sent_bytes", "sent_packets", "received_bytes", "received_packets")
            ),
        )
        for count in now
    )
