"""Ports of a DDS domain, and the participants on this machine that use them.

Discovery of a participant: 7400 + 250 * domain + 10 + 2 * participant (DDSI-RTPS 2.5, section 9.6.2.3).
"""

from __future__ import annotations

from pathlib import Path

from dds_trace.base import limits
from dds_trace.base.errors import OptionError

PARTICIPANTS_PER_DOMAIN = 120
_PORT_BASE, _DOMAIN_GAIN, _FIRST_PARTICIPANT = 7400, 250, 10
_PROC = Path("/proc")


def check_domain_id(domain_id: int) -> None:
    limits.check(limits.DOMAIN_ID, domain_id, "--domain")


def check_domain(domain_id: int, proc: Path = _PROC) -> list[str]:
    """Return warnings about joining a domain now.

    Raises:
        OptionError: there is no such domain, or no port left in it.
    """
    check_domain_id(domain_id)
    ports = bound_udp_ports(proc)
    if len(participants_in(domain_id, ports)) >= PARTICIPANTS_PER_DOMAIN:
        raise OptionError(
            f"--domain {domain_id}: {PARTICIPANTS_PER_DOMAIN} participants of this machine are in it already, and "
            f"the next one would use ports of domain {domain_id + 1}; stop some of them or choose another domain"
        )
    warnings = []
    if domain_id > 0 and len(participants_in(domain_id - 1, ports)) >= PARTICIPANTS_PER_DOMAIN:
        warnings.append(
            f"domain {domain_id - 1} is full on this machine: its next participants use ports of domain {domain_id}"
        )
    last_port = domain_port_range(domain_id)[-1]
    ephemeral = first_ephemeral_port(proc)
    if ephemeral is not None and last_port >= ephemeral:
        warnings.append(
            f"the ports of domain {domain_id} ({first_port(domain_id)} to {last_port}) reach into those that the "
            f"kernel gives to any program (from {ephemeral}); a domain up to 101 is safe on a stock Linux"
        )
    return warnings


def first_port(domain_id: int) -> int:
    return _PORT_BASE + _DOMAIN_GAIN * domain_id


def domain_port_range(domain_id: int) -> range:
    """Return the 250 ports of a domain."""
    return range(first_port(domain_id), first_port(domain_id + 1))


def participants_in(domain_id: int, ports: set[int]) -> list[int]:
    first = first_port(domain_id) + _FIRST_PARTICIPANT
    return [number for number in range(PARTICIPANTS_PER_DOMAIN) if first + 2 * number in ports]


def bound_udp_ports(proc: Path = _PROC) -> set[int]:
    ports: set[int] = set()
    for name in ("net/udp", "net/udp6"):
        try:
            lines = (proc / name).read_text().splitlines()[1:]
        except OSError:  # no such protocol here
            continue
        ports.update(int(line.split()[1].rpartition(":")[2], 16) for line in lines)
    return ports


def first_ephemeral_port(proc: Path = _PROC) -> int | None:
    """Return the lowest ephemeral port, if the kernel reports it."""
    try:
        return int((proc / "sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return None
