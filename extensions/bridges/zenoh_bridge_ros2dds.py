"""`zenoh-bridge-ros2dds`: Eclipse zenoh's bridge for ROS 2, successor of `zenoh-bridge-dds`; a half for each domain."""

from __future__ import annotations

import os

from dds_trace.recorder.backends.ros2.installation import find_program
from dds_trace.recorder.choices import Discovery

from .base import Bridge, BridgeOptions, Halves
from .programs import program_on_path, reported_version
from .zenoh_link import plugin_arguments, plugin_configuration, router_with, zenoh_environment

PROGRAM, PLUGIN, PACKAGE = "zenoh-bridge-ros2dds", "ros2dds", "zenoh_bridge_ros2dds"


def _configuration(options: BridgeOptions) -> str:
    (side,) = options.sides()
    ros2dds = {
        "nodename": f"dds_trace_bridge_{side.domain_id}",
        "domain": side.domain_id,
        "ros_localhost_only": options.discovery is Discovery.LOCALHOST,
        # Interfaces of other kinds do not cross.
        "allow": {"publishers": [f"/{name}" for name in side.takes], "subscribers": [f"/{name}" for name in side.puts]},
        "reliable_routes_blocking": True,
    }
    return plugin_configuration(PLUGIN, ros2dds, options)


BRIDGE = Bridge(
    name=PROGRAM,
    install="build it with `just install-zenoh-bridge` in a clone (needs cargo), or get it from https://download.eclipse.org/zenoh/zenoh-plugin-ros2dds/latest/ and put it on the PATH",
    tried="1.10.2, November 2026",
    suffix=".json5",
    configuration=_configuration,
    find=lambda: program_on_path(PROGRAM) or find_program(PACKAGE, PACKAGE) or router_with(PLUGIN),
    version=lambda program: reported_version(program, "--version"),
    arguments=lambda program: plugin_arguments(program, PLUGIN),
    # ROS 2 before Iron has no discovery ranges.
    environment=lambda options: zenoh_environment(
        options, names_loopback="" < os.environ.get("ROS_DISTRO", "") < "iron"
    ),
    halves=Halves.ALWAYS,
    secures_link=True,
    compiled_in="cyclonedds",
    needs_ros_nodes=True,
)
