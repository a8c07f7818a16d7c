"""The link between two zenoh programs of a bridge: the part of a zenoh configuration that all our zenoh bridges share."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..backends.cyclone_settings import cyclone_settings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .options import BridgeOptions


def zenoh_link(options: BridgeOptions, mode: str) -> dict[str, object]:
    """Return `mode`, `listen`, `connect` and `scouting` of a zenoh configuration.

    The halves meet at the given addresses alone: multicast and gossip stay off, so that no other zenoh program of
    the network joins in. A half that only connects does not listen at all.
    """
    return {
        "mode": mode,
        "listen": {"endpoints": [f"tcp/{options.listen}"] if options.listen else []},
        "connect": {
            "endpoints": [f"tcp/{peer}" for peer in options.peers],
            "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }


def zenoh_environment(options: BridgeOptions) -> Mapping[str, str]:
    """Return the settings that let the Cyclone DDS in a zenoh bridge meet ROS 2 nodes, and those of the log."""
    log = {"RUST_LOG": "z=info", "NO_COLOR": "1"}
    settings = cyclone_settings(options.discovery, tuned=options.tuned)
    return {**log, "CYCLONEDDS_URI": settings} if settings else log
