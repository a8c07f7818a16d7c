"""`zenoh-bridge-ros2dds`: Eclipse zenoh's bridge for ROS 2, successor of `zenoh-bridge-dds`; one half for each domain.

Its maintainers recommend it for ROS 2. Unlike its predecessor it knows ROS names and directions, so the configuration
lists for each side the topics that may leave and those that may come in. It comes as a program, and as a plugin of
zenoh's router: `zenohd` with `libzenoh_plugin_ros2dds.so` beside it, which is what `just install-zenoh-bridge` builds.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..choices import Discovery
from .base import Halves
from .process.programs import reported_version, ros_package_program
from .zenoh_link import plugin_arguments, router_with, zenoh_environment, zenoh_link

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .options import BridgeOptions

PROGRAM = "zenoh-bridge-ros2dds"
PLUGIN = "ros2dds"


@dataclass(frozen=True, slots=True)
class ZenohBridgeRos2dds:
    """Eclipse zenoh's bridge for ROS 2; see `Bridge` for the names."""

    name: str = PROGRAM
    install: str = "build it with `just install-zenoh-bridge` (needs cargo), or get it from https://download.eclipse.org/zenoh/zenoh-plugin-ros2dds/latest/ and put it on the PATH"
    halves: Halves = Halves.ALWAYS
    suffix: str = ".json5"
    up_pattern: str | None = None
    needs_ros_nodes: bool = True

    def configuration(self, options: BridgeOptions) -> str:
        """Return JSON, which is JSON5: the domain, the topics of each direction, and the addresses of the halves."""
        (side,) = options.sides()
        ros2dds = {
            "nodename": f"dds_trace_bridge_{side.domain_id}",
            "domain": side.domain_id,
            "ros_localhost_only": options.discovery is Discovery.LOCALHOST,
            # A kind of interface that is not named here is not allowed at all.
            "allow": {
                "publishers": [f"/{name}" for name in side.takes],
                "subscribers": [f"/{name}" for name in side.puts],
            },
            "reliable_routes_blocking": True,
        }
        return (
            json.dumps({"plugins": {"ros2dds": ros2dds}, **zenoh_link(options, mode="router")}, indent=2)
            + "\n"
        )

    def find(self) -> Path | None:
        """Return the program on the PATH, else that of the sourced ROS 2 installation, else `zenohd` of our recipe."""
        if path := shutil.which(PROGRAM):
            return Path(path)
        return ros_package_program("zenoh_bridge_ros2dds", "zenoh_bridge_ros2dds") or router_with(PLUGIN)

    def version(self, program: Path) -> str:
        """Return the line of `--version`."""
        return reported_version(program, "--version")

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the program, or the router with the plugin that must load, with its file."""
        del options
        return (str(program), *plugin_arguments(program, PLUGIN), "-c", str(configuration))

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return the settings of the Cyclone DDS inside."""
        del program
        return zenoh_environment(options, names_loopback=is_before_iron())


BRIDGE = ZenohBridgeRos2dds()


def is_before_iron() -> bool:
    """Tell whether the bridge takes ROS 2 for one without discovery ranges: it then names the loopback interface itself."""
    return "" < os.environ.get("ROS_DISTRO", "") < "iron"
