"""Which bridges there are, and the file that each is described in."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

if TYPE_CHECKING:
    from .base import Bridge

BRIDGE_MODULES = {
    "builtin": "dds_trace.recorder.bridges.builtin",
    "builtin-zenoh": "dds_trace.recorder.bridges.builtin_zenoh",
    "zenoh-bridge-dds": "dds_trace.recorder.bridges.zenoh_bridge_dds",
    "zenoh-bridge-ros2dds": "dds_trace.recorder.bridges.zenoh_bridge_ros2dds",
    "integration-service": "dds_trace.recorder.bridges.integration_service",
    "ddsrouter": "dds_trace.recorder.bridges.ddsrouter",
    "routing-service": "dds_trace.recorder.bridges.routing_service",
    "domain_bridge": "dds_trace.recorder.bridges.domain_bridge",
}
"""Name of each bridge and the module that holds its `BRIDGE`."""


def load_bridge(name: str) -> Bridge:
    """The bridge called `name`.

    Raises:
        OptionError: there is no such bridge.
    """
    if name not in BRIDGE_MODULES:
        raise OptionError(f"there is no bridge {name!r}; choose one of {', '.join(BRIDGE_MODULES)}")
    bridge: Bridge = import_module(BRIDGE_MODULES[name]).BRIDGE
    return bridge
