"""`zenoh-bridge-dds`: Eclipse zenoh's bridge for DDS, the paper's choice for Cyclone DDS; one half for each domain.

The same bridge comes as a program, `zenoh-bridge-dds`, and as a plugin of zenoh's router: `zenohd` with
`libzenoh_plugin_dds.so` beside it, which is what `just install-zenoh-bridge` builds. One configuration fits both.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..choices import Discovery
from .base import Halves
from .process.programs import reported_version
from .zenoh_link import plugin_arguments, router_with, zenoh_environment, zenoh_link

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .options import BridgeOptions

PLUGIN = "dds"


@dataclass(frozen=True, slots=True)
class ZenohBridgeDds:
    """Eclipse zenoh's bridge for DDS; see `Bridge` for the names."""

    name: str = "zenoh-bridge-dds"
    install: str = (
        "build it with `just install-zenoh-bridge` (needs cargo), or get zenoh-bridge-dds from "
        "https://download.eclipse.org/zenoh/zenoh-plugin-dds/latest/"
    )
    halves: Halves = Halves.ALWAYS
    suffix: str = ".json5"
    up_pattern: str | None = None
    needs_ros_nodes: bool = False

    def configuration(self, options: BridgeOptions) -> str:
        """Return JSON, which is JSON5: the domain, the allowed topics, and the addresses at which the halves meet."""
        (side,) = options.sides()
        names = sorted((*side.takes, *side.puts))
        dds = {
            "domain": side.domain_id,
            "localhost_only": options.discovery is Discovery.LOCALHOST,
            # The expression is searched for anywhere in the name, and `rt/` is ROS 2's prefix of topics.
            "allow": f"^rt/({'|'.join(names)})$",
            "reliable_routes_blocking": True,
        }
        return json.dumps({"plugins": {"dds": dds}, **zenoh_link(options, mode="router")}, indent=2) + "\n"

    def find(self) -> Path | None:
        """Return `zenoh-bridge-dds` on the PATH, else `zenohd` with the plugin in the folder of our recipe."""
        if path := shutil.which("zenoh-bridge-dds"):
            return Path(path)
        return router_with(PLUGIN)

    def version(self, program: Path) -> str:
        """Return the line of `--version`."""
        return reported_version(program, "--version")

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the program, or the router with the plugin that must load."""
        del options
        return (str(program), *plugin_arguments(program, PLUGIN), "-c", str(configuration))

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return the settings of the Cyclone DDS inside."""
        del program
        return zenoh_environment(options, names_loopback=True)


BRIDGE = ZenohBridgeDds()
