"""Campaigns: plans, sweeps on several devices and links, searches over settings."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    commands={
        "sweep": "commands.sweep:app",
        "sweep new": "commands.new:app",
        "capacity": "commands.sweep:capacity",
        "explain rates": "commands.explain:rates",
        "explain size": "commands.explain:size",
        "advise": "commands.advise:app",
    },
    checks={"links": "station.namespaces:permitted"},
)
