"""`zenoh-bridge-ros2dds`: Eclipse zenoh's bridge for ROS 2, successor of `zenoh-bridge-dds`; one half for each domain.

It knows ROS names and directions, so the configuration lists for each half the topics that leave and those that come in.
It comes as a program, and as a plugin of zenoh's router (`zenohd`).
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from ..backends.ros2.installation import find_program
from ..choices import Discovery
from .base import Bridge, Halves
from .process.programs import program_on_path, reported_version
from .zenoh_link import plugin_arguments, plugin_configuration, router_with, zenoh_environment

if TYPE_CHECKING:
    from .base import BridgeOptions

PROGRAM, PLUGIN, PACKAGE = "zenoh-bridge-ros2dds", "ros2dds", "zenoh_bridge_ros2dds"


def configuration(options: BridgeOptions) -> str:
    """Return JSON: the domain, the topics of each direction, and the addresses at which the halves meet."""
    (side,) = options.sides()
    ros2dds = {
        "nodename": f"dds_trace_bridge_{side.domain_id}",
        "domain": side.domain_id,
        "ros_localhost_only": options.discovery is Discovery.LOCALHOST,
        # Interfaces of a kind that is not named here do not cross.
        "allow": {
            "publishers": [f"/{name}" for name in side.takes],
            "subscribers": [f"/{name}" for name in side.puts],
        },
        "reliable_routes_blocking": True,
    }
    return plugin_configuration(PLUGIN, ros2dds, options)


def is_before_iron() -> bool:
    """Return whether the bridge takes ROS 2 for one without discovery ranges and names the loopback interface itself."""
    return "" < os.environ.get("ROS_DISTRO", "") < "iron"


BRIDGE = Bridge(
    name=PROGRAM,
    install="build it with `just install-zenoh-bridge` (needs cargo), or get it from https://download.eclipse.org/zenoh/zenoh-plugin-ros2dds/latest/ and put it on the PATH",
    suffix=".json5",
    configuration=configuration,
    find=lambda: program_on_path(PROGRAM) or find_program(PACKAGE, PACKAGE) or router_with(PLUGIN),
    version=lambda program: reported_version(program, "--version"),
    arguments=lambda program: plugin_arguments(program, PLUGIN),
    environment=lambda options: zenoh_environment(options, names_loopback=is_before_iron()),
    halves=Halves.ALWAYS,
    needs_ros_nodes=True,
)
