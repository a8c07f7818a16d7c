"""`zenoh-bridge-dds`: Eclipse zenoh's bridge for DDS, the paper's choice for Cyclone DDS; a half for each domain."""

from __future__ import annotations

from dds_trace.recorder.choices import Discovery

from .base import Bridge, BridgeOptions, Halves
from .programs import program_on_path, reported_version
from .zenoh_link import plugin_arguments, plugin_configuration, router_with, zenoh_environment

PROGRAM, PLUGIN = "zenoh-bridge-dds", "dds"


def _configuration(options: BridgeOptions) -> str:
    (side,) = options.sides()
    names = sorted((*side.takes, *side.puts))
    dds = {
        "domain": side.domain_id,
        "localhost_only": options.discovery is Discovery.LOCALHOST,
        # The pattern may match anywhere; `rt/` is ROS 2's prefix of topics.
        "allow": f"^rt/({'|'.join(names)})$",
        "reliable_routes_blocking": True,
    }
    return plugin_configuration(PLUGIN, dds, options)


BRIDGE = Bridge(
    name=PROGRAM,
    install=(
        "build it with `just install-zenoh-bridge` in a clone (needs cargo), or get zenoh-bridge-dds from "
        "https://download.eclipse.org/zenoh/zenoh-plugin-dds/latest/"
    ),
    tried="1.10.2, November 2026",
    suffix=".json5",
    configuration=_configuration,
    find=lambda: program_on_path(PROGRAM) or router_with(PLUGIN),
    version=lambda program: reported_version(program, "--version"),
    arguments=lambda program: plugin_arguments(program, PLUGIN),
    environment=lambda options: zenoh_environment(options, names_loopback=True),
    halves=Halves.ALWAYS,
    secures_link=True,
    compiled_in="cyclonedds",
)
