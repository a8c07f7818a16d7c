"""Bridges between two DDS domains: configure, start, supervise."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    commands={"bridge": "command:app"},
    choices={"--bridge": "base:BRIDGE_MODULES"},
    checks={"bridges": "command:installed"},
    parts={"check_bridge": "running:check_requested_bridge", "open_bridge": "running:open_bridge"},
)
