"""What the backends other than `ros2` refuse alike: an option that would be ignored is one the user believes in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

from .base import ExecutorKind, Transport
from .domains import LAST_DOMAIN, first_port
from .qos import asked_durations

if TYPE_CHECKING:
    from collections.abc import Collection

    from dds_trace.tracefile import Qos

    from .base import NodeOptions


def refuse_others_options(
    backend: str, options: NodeOptions, transports: Collection[Transport] = (Transport.DEFAULT,)
) -> None:
    """Refuse options that `backend` has no meaning for.

    Raises:
        OptionError: naming the option and what the backend knows.
    """
    if not 0 <= options.domain_id <= LAST_DOMAIN:
        raise OptionError(f"--domain {options.domain_id}: a DDS domain id is 0 to {LAST_DOMAIN}")
    if options.rmw is not None:
        raise OptionError(f"--rmw {options.rmw}: the backend {backend} has no ROS middleware; leave it out")
    if options.executor is not ExecutorKind.AUTO:
        raise OptionError(
            f"--executor {options.executor.value}: the backend {backend} has none; leave it out"
        )
    if options.transport not in transports:
        known = ", ".join(transport.value for transport in transports)
        raise OptionError(f"--transport {options.transport.value}: the backend {backend} knows {known}")


def refuse_durations(backend: str, qos: Qos) -> None:
    """Refuse a deadline and a lifespan, which DDS alone has.

    Raises:
        OptionError: one is asked for.
    """
    for policy in asked_durations(qos):
        raise OptionError(f"--{policy}: the backend {backend} has no such quality of service; leave it out")


def refuse_typed(backend: str, typed: bool) -> None:
    """Refuse message objects, which only a ROS client library has.

    Raises:
        OptionError: typed messages are asked for.
    """
    if typed:
        raise OptionError(f"--serialization typed: the backend {backend} carries serialized messages alone")


def refuse_peers(backend: str, options: NodeOptions) -> None:
    """Refuse addresses where discovery finds the others.

    Raises:
        OptionError: addresses are given.
    """
    if options.peers:
        raise OptionError(
            f"--peer {options.peers[0]}: the backend {backend} finds the others by itself; leave it out"
        )


# Of the 250 UDP ports of a DDS domain, participants use 0, 1 and those from 10 on.
SOCKET_PORT, ZENOH_PORT = 8, 9


def port_of(domain_id: int, number: int) -> int:
    """A port of `domain_id` that no DDS participant uses: `SOCKET_PORT` or `ZENOH_PORT`."""
    return first_port(domain_id) + number


def peer_addresses(backend: str, options: NodeOptions, port: int) -> tuple[tuple[str, int], ...]:
    """Host and port of the relays that a ping connects to; `port` where none is given.

    Raises:
        OptionError: an address cannot be read, or there is none and the relay need not be on this device.
    """
    if options.discovery.value == "localhost" and not options.peers:
        return (("127.0.0.1", port),)
    if not options.peers:
        raise OptionError(
            f"the backend {backend} does not look for relays on the network: give the relay's device with "
            "--peer HOST, or --discovery localhost if it is on this one"
        )
    return tuple(_address(text, port) for text in options.peers)


def _address(text: str, port: int) -> tuple[str, int]:
    host, colon, number = text.rpartition(":")
    if not colon:
        return text, port
    if not host or not number.isdecimal() or not 0 < int(number) < 1 << 16:
        raise OptionError(f"--peer {text}: write HOST or HOST:PORT")
    return host, int(number)
