"""`domain_bridge`: ROS 2's own package that bridges domains."""

from __future__ import annotations

from dds_trace.recorder.backends.qos import requested_durations
from dds_trace.recorder.backends.ros2.installation import find_program, package_version

from .base import Bridge, BridgeOptions
from .programs import discovery_environment
from .texts import yaml_text

PACKAGE = "domain_bridge"


def _configuration(options: BridgeOptions) -> str:
    ping, relay = options.sides()
    qos = {
        "reliability": options.qos.reliability,
        "durability": options.qos.durability,
        "history": options.qos.history,
        "depth": options.qos.depth,
        **requested_durations(options.qos),  # ns
    }
    topics = {
        name: {"type": options.type_of(name), "from_domain": source.domain_id, "to_domain": there.domain_id, "qos": qos}
        for source, there in ((ping, relay), (relay, ping))
        for name in source.takes
    }
    return yaml_text({"name": "dds_trace_bridge", "topics": topics})


BRIDGE = Bridge(
    name=PACKAGE,
    install="apt install ros-$ROS_DISTRO-domain-bridge, then source /opt/ros/$ROS_DISTRO/setup.bash",
    tried="never run",
    suffix=".yaml",
    configuration=_configuration,
    find=lambda: find_program(PACKAGE, PACKAGE),
    version=lambda _: package_version(PACKAGE) or "",
    environment=discovery_environment,
)
