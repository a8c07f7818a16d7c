"""Words of the commands that measure a setup again."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.setting import parse_setting
from dds_trace.base.printable import printable

if TYPE_CHECKING:
    from .groups import Series

_OPTIONS = ("transport", "executor", "security", "congestion_control", "load")
"""Keys of a setting that are options of the same name, with their value."""


def commands_of(series: Series) -> dict[str, str]:
    """Return the options of `dds-record` for relay and ping of a setup, by role."""
    setting = parse_setting(series.setting)
    shared = [
        *(word for name in _OPTIONS if name in setting for word in (f"--{name.replace('_', '-')}", setting[name])),
        *(["--tuned"] if setting.get("tuned") == "true" else []),
        *(["--reliability", series.reliability] if series.reliability != "reliable" else []),
        *(["--durability", series.durability] if series.durability != "volatile" else []),
        *(["--depth", str(series.depth)] if series.depth not in (None, 10) else []),
        *(["--serialization", series.serialization] if series.serialization != "raw" else []),
    ]
    bridge = [] if series.bridge == "none" else ["--bridge", series.bridge]
    ping_domain, relay_domain = series.ping_domain_id, series.relay_domain_id
    across = [] if series.bridge == "none" or relay_domain is None else ["--relay-domain", str(relay_domain)]
    sides = {
        "relay": (series.relay_backend or series.backend, ping_domain if relay_domain is None else relay_domain, []),
        "ping": (series.backend, ping_domain, [*bridge, *across]),
    }
    return {
        role: printable(shlex.join(["--backend", backend, *_rmw(series, role), *_domain(domain), *own, *shared]))
        for role, (backend, domain, own) in sides.items()
    }


def _rmw(series: Series, role: str) -> list[str]:
    is_like_ping = role == "ping" or series.relay_backend in (None, series.backend)
    return ["--rmw", series.rmw] if series.rmw and series.backend == "ros2" and is_like_ping else []


def _domain(domain_id: int | None) -> list[str]:
    return [] if domain_id is None else ["--domain", str(domain_id)]
