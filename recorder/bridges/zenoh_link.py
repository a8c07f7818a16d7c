"""What all our zenoh bridges share: the link between two zenoh programs, and zenoh's router with a plugin as the program."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from ..backends.cyclone_settings import cyclone_loopback, cyclone_settings

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


def zenoh_environment(options: BridgeOptions, *, names_loopback: bool) -> Mapping[str, str]:
    """Return the settings that let the Cyclone DDS in a zenoh bridge meet ROS 2 nodes, and those of the log.

    Args:
        options: of the bridge.
        names_loopback: whether the bridge itself keeps its Cyclone DDS on the loopback interface; named twice, Cyclone
            DDS does not start.
    """
    log = {"RUST_LOG": "z=info", "NO_COLOR": "1"}
    loopback = "" if names_loopback else cyclone_loopback(options.discovery)
    settings = ",".join(filter(None, (loopback, cyclone_settings(options.discovery, tuned=options.tuned))))
    return {**log, "CYCLONEDDS_URI": settings} if settings else log


def installed_folder() -> Path:
    """Return the folder of the router and the plugins that `just install-zenoh-bridge` builds."""
    data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(data) / "dds-trace" / "zenoh-bridge-dds"


def router_with(plugin: str) -> Path | None:
    """Return `zenohd` in the folder of our recipe if the plugin's library is beside it."""
    router = installed_folder() / "zenohd"
    return router if router.is_file() and _library(router, plugin).is_file() else None


def plugin_arguments(program: Path, plugin: str) -> tuple[str, ...]:
    """Return what makes zenoh's router load a plugin or end; nothing for a bridge's own program."""
    return ("-P", f"{plugin}:{_library(program, plugin)}") if program.name == "zenohd" else ()


def _library(router: Path, plugin: str) -> Path:
    return router.with_name(f"libzenoh_plugin_{plugin}.so")
