"""The bridges between two DDS domains: one file for each, launched and supervised, never imported by a role."""

from typing import TYPE_CHECKING

from dds_trace.lazy import contents_page

if TYPE_CHECKING:
    from .base import BRIDGE_MODULES, Bridge, Halves, load_bridge, split_halves
    from .options import BRIDGED_TOPICS, BridgedTopic, BridgeOptions, Half, bridged_topic
    from .process.running import BridgeState, RunningBridge, find_program, open_bridge
else:
    __getattr__, __dir__ = contents_page(__name__)

__all__ = [
    "BRIDGED_TOPICS",
    "BRIDGE_MODULES",
    "Bridge",
    "BridgeOptions",
    "BridgeState",
    "BridgedTopic",
    "Half",
    "Halves",
    "RunningBridge",
    "bridged_topic",
    "find_program",
    "load_bridge",
    "open_bridge",
    "split_halves",
]
