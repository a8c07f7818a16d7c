"""Which interfaces carry a run's messages: loopback under localhost discovery, else all that are up."""

from __future__ import annotations

import fcntl
import socket
import struct
from pathlib import Path

from ..choices import Discovery

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
