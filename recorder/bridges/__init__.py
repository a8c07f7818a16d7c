"""The bridges between two DDS domains: one file for each, launched and supervised, never imported by a role."""

from .base import (
    BRIDGED_TOPICS,
    Bridge,
    BridgedTopic,
    BridgeOptions,
    Half,
    Halves,
    bridged_topic,
    split_halves,
)
from .process.running import BridgeState, RunningBridge, find_program, open_bridge
from .registry import BRIDGE_MODULES, load_bridge

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
