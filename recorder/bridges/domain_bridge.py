"""`domain_bridge`: ROS 2's own package that bridges domains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..backends.qos import asked_durations
from .base import Halves
from .process.programs import (
    discovery_environment,
    ros_package_program,
    ros_package_version,
)
from .texts import yaml_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from .options import BridgeOptions

PACKAGE = "domain_bridge"


@dataclass(frozen=True, slots=True)
class DomainBridge:
    """ROS 2's domain_bridge; see `Bridge` for the names."""

    name: str = PACKAGE
    install: str = "apt install ros-$ROS_DISTRO-domain-bridge, then source /opt/ros/$ROS_DISTRO/setup.bash"
    halves: Halves = Halves.NEVER
    suffix: str = ".yaml"
    up_pattern: str | None = None
    needs_ros_nodes: bool = False

    def configuration(self, options: BridgeOptions) -> str:
        """Return YAML: each topic with its type, its direction and the quality of service of its two ends."""
        ping, relay = options.sides()
        topics: dict[str, object] = {}
        for here, there in ((ping, relay), (relay, ping)):
            for name in here.takes:
                topics[name] = {
                    "type": options.type_of(name),
                    "from_domain": here.domain_id,
                    "to_domain": there.domain_id,
                    "qos": {
                        "reliability": options.qos.reliability,
                        "durability": options.qos.durability,
                        "history": options.qos.history,
                        "depth": options.qos.depth,
                        **asked_durations(options.qos),  # in ns
                    },
                }
        return yaml_text({"name": "dds_trace_bridge", "topics": topics})

    def find(self) -> Path | None:
        """Return the program of the sourced ROS 2 installation."""
        return ros_package_program(PACKAGE, PACKAGE)

    def version(self, program: Path) -> str:
        """Return the version in the package's manifest."""
        return ros_package_version(program, PACKAGE)

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the program with its file, which must be the last argument."""
        del options
        return (str(program), str(configuration))

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return the discovery range of the ROS 2 inside."""
        del program
        return discovery_environment(options)


BRIDGE = DomainBridge()
