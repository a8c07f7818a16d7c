"""The description of a recording: its `Session`."""

from __future__ import annotations

import os
from pathlib import Path

from dds_trace.base.version import __version__
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.json_fields import JsonObject

from ..applied.carried import LOOPBACK
from ..backends import load_backend, load_backends
from ..backends.node import Node
from ..backends.other_side import Strangers
from ..choices import Discovery
from ..host.clock import ClockAnchor
from ..host.environment import join_environments
from ..host.fingerprint import host_fingerprint, read_boot_id
from ..kernel.counters import read_interfaces


def describe_session(
    node: Node,
    anchor: ClockAnchor,
    *,
    role: str,
    session_id: int,
    device: str | None = None,
    connectivity: str | None = None,
    relay_id: int | None = None,
    extra: JsonObject | None = None,
) -> Session:
    """Describe the session of a role, its middleware and this device.

    By default the device has its host name, and `default_connectivity`; a ping has no `relay_id`.
    """
    middleware = node.middleware
    # Of all backends: ROS middleware reads its vendor's files, and a bridge may have another vendor.
    environment = join_environments(backend.environment for backend in load_backends())
    host = host_fingerprint(middleware.versions, environment)
    vendor_label = middleware.vendor_label or load_backend(middleware.backend).label
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
        extra={
            "vendor_label": vendor_label,
            "recorder_version": __version__,
            "boot_id": read_boot_id(),
            **(extra or {}),
        },
    )


def strangers_field(strangers: Strangers) -> JsonObject:
    counts = strangers.counts
    return {"strangers": dict(sorted(counts.items()))} if counts else {}


def default_connectivity(discovery: Discovery, root: Path = Path("/")) -> str:
    """Return `loopback`, also where no interface leads elsewhere; else `wireless` or `wired` by the default route."""
    if discovery is Discovery.LOCALHOST:
        return "loopback"
    try:
        routes = [line.split() for line in (root / "proc/net/route").read_text().splitlines()[1:]]
        other_interfaces = read_interfaces(root / "proc").keys() - {LOOPBACK}
    except OSError:
        routes, other_interfaces = [], {""}
    if not routes and not other_interfaces:
        return "loopback"
    interface = next((route[0] for route in routes if route[1] == "00000000"), None)
    is_wireless = interface is not None and (root / "sys/class/net" / interface / "wireless").exists()
    return "wireless" if is_wireless else "wired"
