"""`integration-service`: eProsima's Integration Service, the paper's choice for Fast DDS."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.units import SECOND_NS

from ..backends.qos import asked_durations
from .base import Halves
from .process.programs import discovery_environment
from .texts import yaml_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dds_trace.tracefile.format.descriptions import Qos

    from .options import BridgeOptions

PROGRAM = "integration-service"


@dataclass(frozen=True, slots=True)
class IntegrationService:
    """eProsima's Integration Service with its ROS 2 system handle; see `Bridge` for the names."""

    name: str = PROGRAM
    install: str = (
        "build Integration-Service and ROS2-SH with colcon and -DMIX_ROS_PACKAGES='std_msgs sensor_msgs' "
        "(https://integration-service.docs.eprosima.com), then source its install/setup.bash"
    )
    halves: Halves = Halves.NEVER
    suffix: str = ".yaml"
    up_pattern: str | None = None
    needs_ros_nodes: bool = False

    def configuration(self, options: BridgeOptions) -> str:
        """Return YAML: a ROS 2 system for each domain, a route each way, each topic on its route."""
        ping, relay = options.sides()
        systems = {side.domain_id: f"domain_{side.domain_id}" for side in (ping, relay)}
        topics: dict[str, object] = {}
        for side, route in ((ping, "ping_to_relay"), (relay, "relay_to_ping")):
            for name in side.takes:
                topics[name] = {
                    "type": _type_name(options.type_of(name)),
                    "route": route,
                    **{system: {"qos": _qos(options.qos)} for system in systems.values()},
                }
        there, back = systems[ping.domain_id], systems[relay.domain_id]
        return yaml_text(
            {
                "systems": {
                    system: {
                        "type": "ros2",
                        "domain": domain_id,
                        "node_name": f"dds_trace_bridge_{domain_id}",
                    }
                    for domain_id, system in systems.items()
                },
                "routes": {
                    "ping_to_relay": {"from": there, "to": back},
                    "relay_to_ping": {"from": back, "to": there},
                },
                "topics": topics,
            },
        )

    def find(self) -> Path | None:
        """Return the program on the PATH."""
        path = shutil.which(PROGRAM)
        return Path(path) if path else None

    def version(self, program: Path) -> str:
        """Return an empty text: the program reports no version."""
        del program
        return ""

    def command(self, program: Path, configuration: Path, options: BridgeOptions) -> Sequence[str]:
        """Return the program with its file."""
        del options
        return (str(program), str(configuration))

    def environment(self, program: Path, options: BridgeOptions) -> Mapping[str, str]:
        """Return the discovery range of the ROS 2 inside."""
        del program
        return discovery_environment(options)


BRIDGE = IntegrationService()


def _type_name(type_name: str) -> str:
    """Return a type's name for the ROS 2 system handle: `sensor_msgs/Image` for `sensor_msgs/msg/Image`."""
    package, _, name = type_name.split("/")
    return f"{package}/{name}"


def _qos(qos: Qos) -> dict[str, object]:
    return {
        "reliability": qos.reliability.upper(),
        "durability": qos.durability.upper(),
        "history": {"kind": qos.history.upper(), "depth": qos.depth},
        **{
            policy: dict(zip(("sec", "nanosec"), divmod(duration_ns, SECOND_NS), strict=True))
            for policy, duration_ns in asked_durations(qos).items()
        },
    }
