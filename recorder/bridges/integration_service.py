"""`integration-service`: eProsima's Integration Service, the paper's choice for Fast DDS."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.units import SECOND_NS

from ..backends.qos import requested_durations
from .base import Bridge
from .process.programs import discovery_environment, program_on_path
from .texts import yaml_text

if TYPE_CHECKING:
    from dds_trace.tracefile.format.descriptions import Qos

    from .base import BridgeOptions

PROGRAM = "integration-service"


def _configuration(options: BridgeOptions) -> str:
    ping, relay = options.sides()
    systems = {side.domain_id: f"domain_{side.domain_id}" for side in (ping, relay)}
    topics = {
        name: {
            "type": options.type_of(name).replace("/msg/", "/"),  # the ROS 2 system handle's spelling
            "route": route,
            **{system: {"qos": _qos(options.qos)} for system in systems.values()},
        }
        for side, route in ((ping, "ping_to_relay"), (relay, "relay_to_ping"))
        for name in side.takes
    }
    there, back = systems[ping.domain_id], systems[relay.domain_id]
    return yaml_text(
        {
            "systems": {
                system: {"type": "ros2", "domain": domain_id, "node_name": f"dds_trace_bridge_{domain_id}"}
                for domain_id, system in systems.items()
            },
            "routes": {"ping_to_relay": {"from": there, "to": back}, "relay_to_ping": {"from": back, "to": there}},
            "topics": topics,
        }
    )


BRIDGE = Bridge(
    name=PROGRAM,
    install=(
        "build Integration-Service and ROS2-SH with colcon and -DMIX_ROS_PACKAGES='std_msgs sensor_msgs' "
        "(https://integration-service.docs.eprosima.com), then source its install/setup.bash"
    ),
    suffix=".yaml",
    configuration=_configuration,
    find=lambda: program_on_path(PROGRAM),
    version=lambda _: "",  # it reports none
    environment=discovery_environment,
)


def _qos(qos: Qos) -> dict[str, object]:
    return {
        "reliability": qos.reliability.upper(),
        "durability": qos.durability.upper(),
        "history": {"kind": qos.history.upper(), "depth": qos.depth},
        **{
            policy: dict(zip(("sec", "nanosec"), divmod(duration_ns, SECOND_NS), strict=True))
            for policy, duration_ns in requested_durations(qos).items()
        },
    }
