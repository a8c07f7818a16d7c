"""What zenoh's bridges share."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from dds_trace.recorder.backends.cyclone_settings import cyclone_settings
from dds_trace.recorder.security.tls import zenoh_tls

from .base import BridgeOptions, Half


def zenoh_link(options: BridgeOptions, mode: str) -> dict[str, object]:
    """Return the part of a zenoh configuration by which halves meet at the given addresses only, with keys by TLS."""
    tls = None if options.keys is None else zenoh_tls(options.keys, listens=options.half is Half.RELAY)
    scheme = "tcp" if tls is None else "tls"
    return {
        "mode": mode,
        "listen": {"endpoints": [f"{scheme}/{options.listen}"] if options.listen else []},
        "connect": {
            "endpoints": [f"{scheme}/{peer}" for peer in options.peers],
            "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        **({} if tls is None else {"transport": {"link": {"tls": tls}, "shared_memory": {"enabled": False}}}),
    }


def plugin_configuration(plugin: str, settings: Mapping[str, object], options: BridgeOptions) -> str:
    return json.dumps({"plugins": {plugin: settings}, **zenoh_link(options, mode="router")}, indent=2) + "\n"


def zenoh_environment(options: BridgeOptions, *, names_loopback: bool) -> Mapping[str, str]:
    """Return settings of the Cyclone DDS in a zenoh bridge, and of its log.

    A bridge that itself names the loopback interface must not get its name again: Cyclone DDS would not start.
    """
    log = {"RUST_LOG": "z=info", "NO_COLOR": "1"}
    settings = cyclone_settings(options.discovery, tuned=options.tuned, on_loopback=not names_loopback)
    return {**log, "CYCLONEDDS_URI": settings} if settings else log


def router_with(plugin: str) -> Path | None:
    data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    router = Path(data) / "dds-trace" / "zenoh-bridge-dds" / "zenohd"
    return router if router.is_file() and _library(router, plugin).is_file() else None


def plugin_arguments(program: Path, plugin: str) -> Sequence[str]:
    required = ("-P", f"{plugin}:{_library(program, plugin)}") if program.name == "zenohd" else ()
    return (*required, "-c")


def _library(router: Path, plugin: str) -> Path:
    return router.with_name(f"libzenoh_plugin_{plugin}.so")
