"""The validator of every key of a plan, table by table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.tracefile import limits

from .cells import AXES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.tracefile.limits import Limit

_AXES: Mapping[str, Limit] = {name: axis.limit for name, axis in AXES.items()}
_DEVICE: Mapping[str, Limit] = {
    "name": limits.NAME,
    "ssh": limits.NAME,
    "ssh_options": limits.TEXT,
    "setup": limits.TEXT,
    "path": limits.TEXT,
    "address": limits.HOST,
    "bridge_port": limits.PORT,
    "options": limits.TEXT,
}

PLAN_LIMITS: Mapping[str, Mapping[str, Limit]] = {
    "": {"name": limits.FILE_NAME, "description": limits.TEXT},
    "axes": _AXES,
    "matrix": _AXES,
    "exclude": {**_AXES, "reason": limits.TEXT},
    "run": {
        "messages": limits.MESSAGES_OR_NONE,
        "seconds": limits.LENGTH_OR_NONE_S,
        "min_messages": limits.MESSAGES,
        "warmup": limits.WARMUP,
        "settle_seconds": limits.WAIT_S,
        "cutoff_seconds": limits.WAIT_S,
        "order": limits.NAME,
        "seed": limits.SEED,
        "repeats": limits.REPEATS,
        "attempts": limits.ATTEMPTS,
        "discovery": limits.NAME,
        "domain": limits.DOMAIN_ID,
        "ping_domain": limits.DOMAIN_ID,
        "wire": limits.FLAG,
    },
    "devices": {"connectivity": limits.NAME},
    "devices.ping": _DEVICE,
    "devices.relay": _DEVICE,
    "network": {"namespaces": limits.FLAG},
    "link": {
        "preset": limits.NAME,
        "name": limits.FILE_NAME,
        "rate_mbit_s": limits.LINE_MBIT_S,
        "delay_ms": limits.DELAY_MS,
        "jitter_ms": limits.DELAY_MS,
        "loss_percent": limits.PERCENT,
        "outage_every_s": limits.WAIT_S,
        "outage_ms": limits.DELAY_MS,
        "queue_ms": limits.DELAY_MS,
    },
    "search": {
        "min_rate": limits.RATE_HZ,
        "max_rate": limits.RATE_HZ,
        "loss_percent": limits.PERCENT,
        "deadline_ms": limits.DEADLINE_MS,
        "percentile": limits.PERCENT,
        "resolution": limits.FACTOR,
        "knee_repeats": limits.KNEE_REPEATS,
        "seconds": limits.LENGTH_S,
    },
}
"""Table of a plan -> its keys -> the validator of each; every key that a plan may have is here."""
