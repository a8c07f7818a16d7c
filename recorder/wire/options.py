"""Options of a capture."""

from __future__ import annotations

import fcntl
import json
import socket
import struct
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..choices import Discovery
from ..domains import domain_port_range
from .packets.packet_filter import PortRange

if TYPE_CHECKING:
    from collections.abc import Mapping


LOOPBACK = "lo"
_SIOCGIFFLAGS, _IFF_UP = 0x8913, 0x1
_SYSTEM = Path("/sys/class/net")


def run_interfaces(discovery: Discovery, system: Path = _SYSTEM) -> tuple[str, ...]:
    """Return the interfaces of this network namespace that a run with this range of discovery uses.

    A port of a bridge or of a bond is left out: its packets pass the bridge or bond too, and would count twice.

    Args:
        discovery: range of the node's discovery.
        system: the kernel's folder of interfaces.
    """
    if discovery is Discovery.LOCALHOST:
        return (LOOPBACK,)
    names = sorted(name for _, name in socket.if_nameindex())
    return tuple(name for name in names if _is_up(name) and not (system / name / "master").exists())


def _is_up(interface: str) -> bool:
    request = struct.pack("16sH14x", interface.encode(), 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request)
        except OSError:  # it was removed meanwhile
            return False
    flags: int = struct.unpack_from("H", answer, 16)[0]
    return bool(flags & _IFF_UP)


def domain_ports(domain_id: int) -> PortRange:
    """Return the UDP ports of a DDS domain (DDSI-RTPS 2.5, section 9.6.2.3)."""
    ports = domain_port_range(domain_id)
    return PortRange(ports[0], ports[-1])


@dataclass(frozen=True, slots=True)
class WireOptions:
    """Interfaces and ports of a capture, and its memory.

    Attributes:
        interfaces: names of those that carry the run's messages.
        rtps_ports: UDP ports of the run's DDS domains (`domain_ports`); RTPS of other domains is left out. Empty: all
            RTPS counts.
        udp_ports: of UDP that is not RTPS: the `socket` backend's, zenoh's scouting.
        tcp_ports: of the `socket` backend, of zenoh, of Fast DDS over TCP.
        ring_bytes: kernel memory for packets on each interface. A second of 100 Mbit/s takes 12.5 MB in IP fragments
            and in packets of several samples' fragments, and a tenth of that otherwise.
        cpus: those that the capturing process may run on, so that it does not share one that a role keeps for itself; empty
            for those of its parent.
        block_timeout_ms: how long the kernel collects packets before it hands them over, and how often they are counted.
    """

    interfaces: tuple[str, ...]
    rtps_ports: tuple[PortRange, ...] = ()
    udp_ports: tuple[PortRange, ...] = ()
    tcp_ports: tuple[PortRange, ...] = ()
    ring_bytes: int = 32 << 20
    block_timeout_ms: int = 100
    cpus: tuple[int, ...] = ()

    def to_json(self) -> str:
        """Return the options as a text for the capturing process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> WireOptions:
        """Return the options in a text of `to_json`."""
        found: Mapping[str, Any] = json.loads(text)
        ports = {
            name: tuple(PortRange(*pair) for pair in found[name])
            for name in ("rtps_ports", "udp_ports", "tcp_ports")
        }
        return cls(
            **{**found, "interfaces": tuple(found["interfaces"]), "cpus": tuple(found["cpus"]), **ports}
        )
