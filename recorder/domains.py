"""Ports of a DDS domain, and the participants on this machine that use them (DDSI-RTPS 2.5, section 9.6.2.3).

Domain d: 7400 + 250 d + {0, 1} for multicast, + {10 + 2 i, 11 + 2 i} for participant i.
"""

from __future__ import annotations

import os
from pathlib import Path

from dds_trace.base import limits
from dds_trace.base.errors import OptionError

from .kernel.counters import PROC, bound_udp_ports, ephemeral_ports

PARTICIPANTS_PER_DOMAIN = 120
_PORT_BASE, _DOMAIN_GAIN, FIRST_PARTICIPANT = 7400, 250, 10
_PORTS_END = 65_536


OWN_DOMAIN, ROBOTS_DOMAIN = 10, 0
"""Default of our own nodes, and ROS 2's."""


def default_domain(*, joins_robot: bool = False) -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if not text:
        return ROBOTS_DOMAIN if joins_robot else OWN_DOMAIN
    if not text.isdecimal() or len(text) > 9:
        raise OptionError(f"ROS_DOMAIN_ID is {limits.shown(text)}, not a domain id; set a number or unset it")
    limits.check(limits.DOMAIN_ID, int(text), "ROS_DOMAIN_ID")
    return int(text)


def check_domain_id(domain_id: int) -> None:
    limits.check(limits.DOMAIN_ID, domain_id, "--domain")


def check_domain(domain_id: int, proc: Path = PROC) -> list[str]:
    """Return warnings about joining a domain now; an `OptionError` without a port left in it."""
    check_domain_id(domain_id)
    bound = bound_udp_ports(proc)
    ports, room = domain_port_range(domain_id), participants_that_fit(domain_id)
    if len(participants_in(domain_id, bound)) >= room:
        beyond = f"ports of domain {domain_id + 1}" if domain_id < limits.LAST_DOMAIN else "ports above 65535"
        raise OptionError(
            f"--domain {domain_id}: {room} participants of this machine are in it already, and the next one would use "
            f"{beyond}; stop some of them or choose another domain"
        )
    warnings = []
    if domain_id > 0 and len(participants_in(domain_id - 1, bound)) >= PARTICIPANTS_PER_DOMAIN:
        warnings.append(
            f"domain {domain_id - 1} is full on this machine: its next participants use ports of domain {domain_id}"
        )
    if room < PARTICIPANTS_PER_DOMAIN:
        warnings.append(
            f"domain {domain_id} has ports for {room} participants on a machine (other domains: "
            f"{PARTICIPANTS_PER_DOMAIN}), as ports end at {ports[-1]}"
        )
    ephemeral = ephemeral_ports(proc)
    if ports[0] < ephemeral.stop and ephemeral.start <= ports[-1]:
        last_below = (ephemeral.start - _PORT_BASE) // _DOMAIN_GAIN - 1
        first_above = -((_PORT_BASE - ephemeral.stop) // _DOMAIN_GAIN)
        clear = [f"up to {last_below}"] * (last_below >= 0)
        clear += [f"from {first_above} to {limits.LAST_DOMAIN}"] * (first_above <= limits.LAST_DOMAIN)
        warnings.append(
            f"the ports of domain {domain_id} ({ports[0]} to {ports[-1]}) overlap those that the kernel gives to any "
            f"program ({ephemeral[0]} to {ephemeral[-1]}), so a participant may find its port taken"
            + (f"; domains {' and '.join(clear)} do not" if clear else "")
        )
    return warnings


def first_port(domain_id: int) -> int:
    return _PORT_BASE + _DOMAIN_GAIN * domain_id


def domain_port_range(domain_id: int) -> range:
    return range(first_port(domain_id), min(first_port(domain_id + 1), _PORTS_END))


def participants_that_fit(domain_id: int) -> int:
    return (len(domain_port_range(domain_id)) - FIRST_PARTICIPANT) // 2


def participants_in(domain_id: int, ports: set[int]) -> list[int]:
    first = first_port(domain_id) + FIRST_PARTICIPANT
    return [number for number in range(participants_that_fit(domain_id)) if first + 2 * number in ports]
