"""Ethernet, IPv4, UDP and TCP headers of all frames of a batch at once."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

UDP, TCP = socket.IPPROTO_UDP, socket.IPPROTO_TCP
_ETHERNET_BYTES, _IPV4_BYTES, _UDP_BYTES = 14, 20, 8
_IPV4 = 0x0800
_RTPS_MAGIC = int.from_bytes(b"RTPS", "big")

Numbers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class FrameBatch:
    """Frames in the ring's memory, by capture at `wall_ns` (CLOCK_REALTIME); valid until the ring's `release`."""

    memory: NDArray[np.uint8]
    position: Numbers
    captured_bytes: Numbers
    wire_bytes: Numbers
    wall_ns: Numbers
    packet_type: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.position)


class Frame(NamedTuple):
    """One frame; a field of a header that it does not have is 0.

    Attributes:
        transport_end: end of the IP packet, captured or not.
        source_port, destination_port: of UDP and TCP; 0 in later fragments.
        time_ns: CLOCK_MONOTONIC.
    """

    protocol: int
    source: int
    destination: int
    ip_id: int
    fragment_offset: int
    more_fragments: bool
    transport: int
    transport_end: int
    seen_end: int
    source_port: int
    destination_port: int
    datagram_bytes: int
    is_rtps: bool
    wire_bytes: int
    time_ns: int
    packet_type: int


def read_frames(batch: FrameBatch, wall_to_monotonic_ns: int) -> Iterator[Frame]:
    begin, captured = batch.position, batch.captured_bytes
    memory = batch.memory

    def number(position: Numbers, octets: int) -> Numbers:
        value = np.zeros(len(position), np.int64)
        for octet in range(octets):
            value = value << 8 | memory[np.minimum(position + octet, memory.size - 1)]
        return value

    is_ipv4 = (captured >= _ETHERNET_BYTES + _IPV4_BYTES) & (number(begin + 12, 2) == _IPV4)
    ip = begin + _ETHERNET_BYTES
    header_bytes = (number(ip, 1) & 0x0F) * 4
    flags = number(ip + 6, 2)
    transport = ip + header_bytes
    transport_end = ip + number(ip + 2, 2)
    seen_end = np.minimum(begin + captured, transport_end)
    protocol = np.where(is_ipv4, number(ip + 9, 1), 0)
    fragment_offset = (flags & 0x1FFF) * 8
    has_ports = is_ipv4 & (fragment_offset == 0) & (transport + _UDP_BYTES <= seen_end)
    is_udp = has_ports & (protocol == UDP)
    columns: dict[str, NDArray[np.generic]] = {
        "protocol": protocol,
        "source": number(ip + 12, 4),
        "destination": number(ip + 16, 4),
        "ip_id": number(ip + 4, 2),
        "fragment_offset": np.where(is_ipv4, fragment_offset, 0),
        "more_fragments": is_ipv4 & (flags & 0x2000 != 0),
        "transport": transport,
        "transport_end": transport_end,
        "seen_end": seen_end,
        "source_port": np.where(has_ports, number(transport, 2), 0),
        "destination_port": np.where(has_ports, number(transport + 2, 2), 0),
        "datagram_bytes": np.where(is_udp, number(transport + 4, 2), 0),
        "is_rtps": is_udp
        & (transport + _UDP_BYTES + 20 <= seen_end)
        & (number(transport + _UDP_BYTES, 4) == _RTPS_MAGIC),
        "wire_bytes": batch.wire_bytes,
        "time_ns": batch.wall_ns + wall_to_monotonic_ns,
        "packet_type": batch.packet_type,
    }
    return map(Frame._make, zip(*(columns[name].tolist() for name in Frame._fields), strict=True))
