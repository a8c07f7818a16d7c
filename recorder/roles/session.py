"""What a recording says of itself: the `Session` of a role on a node."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import Session

from ..backends.base import Discovery
from ..host.fingerprint import host_fingerprint

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..backends.base import Node
    from ..host.clock import ClockAnchor


def describe_session(
    node: Node,
    anchor: ClockAnchor,
    *,
    role: str,
    session_id: int,
    device: str | None = None,
    connectivity: str | None = None,
    relay_id: int | None = None,
    extra: Mapping[str, Any] | None = None,
) -> Session:
    """The session of a role on an open node, as the running middleware and this device are.

    Args:
        node: where the role runs.
        anchor: what ties the events' monotonic clock to the wall clock.
        role: `ping` or `relay`.
        session_id: 64 random bits.
        device: the device's name, by default its host name.
        connectivity: how it reaches the others, by default `default_connectivity`.
        relay_id: of a relay.
        extra: further fields.
    """
    middleware = node.middleware
    host = host_fingerprint(middleware.versions)
    return Session(
        session_id=session_id,
        role=role,
        device=device or os.uname().nodename,
        backend=middleware.backend,
        vendor=middleware.vendor,
        rmw=middleware.rmw,
        domain_id=node.options.domain_id,
        relay_id=relay_id,
        connectivity=connectivity or default_connectivity(node.options.discovery),
        wall_anchor_ns=anchor.wall_ns,
        monotonic_anchor_ns=anchor.monotonic_ns,
        host={**host, "middleware": dict(middleware.settings)},
        extra=extra or {},
    )


def default_connectivity(discovery: Discovery, root: Path = Path("/")) -> str:
    """`loopback`, or by the interface of the default route `wireless` or `wired`."""
    if discovery is Discovery.LOCALHOST:
        return "loopback"
    try:
        routes = [line.split() for line in (root / "proc/net/route").read_text().splitlines()[1:]]
    except OSError:
        routes = []
    interface = next((route[0] for route in routes if route[1] == "00000000"), None)
    is_wireless = interface is not None and (root / "sys/class/net" / interface / "wireless").exists()
    return "wireless" if is_wireless else "wired"
