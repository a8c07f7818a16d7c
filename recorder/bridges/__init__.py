"""The bridges between two DDS domains: one file for each, launched and supervised, never imported by a role."""

from dds_trace.recorder.bridges.base import (
    BRIDGED_TOPICS,
    Bridge,
    BridgedTopic,
    BridgeOptions,
    Half,
    Halves,
    bridged_topic,
    split_halves,
)
from dds_trace.recorder.bridges.process.running import BridgeState, RunningBridge, find_program, open_bridge
from dds_trace.recorder.bridges.registry import BRIDGE_MODULES, load_bridge

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
