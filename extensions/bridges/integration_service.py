"""`integration-service`: eProsima's Integration Service, with a static or a dynamic ROS 2 handle (docs/reference/bridges.md)."""

from __future__ import annotations

import os
from pathlib import Path

from dds_trace.base.units import SECOND_NS
from dds_trace.recorder.backends.qos import requested_durations
from dds_trace.recorder.choices import History
from dds_trace.tracefile.format.descriptions import Qos

from .base import Bridge, BridgeOptions
from .programs import discovery_environment, program_on_path
from .texts import yaml_text

PROGRAM = "integration-service"
STATIC, DYNAMIC = "ros2", "ros2_dynamic"
PREFIX_VARIABLES = ("IS_PREFIX_PATH", "LD_LIBRARY_PATH")
SYSTEM_PREFIXES = ("/usr/lib", "/usr/local/lib")


def _configuration(options: BridgeOptions) -> str:
    ping, relay = options.sides()
    handle = DYNAMIC if _has_handle(DYNAMIC) and not _has_handle(STATIC) else STATIC
    separator = "/" if handle == STATIC else "::msg::"
    types = {topic.type_name: topic.type_name.replace("/msg/", separator) for topic in options.topics}
    using = {"using": sorted(name.replace("/msg/", "/") for name in types)} if handle == DYNAMIC else {}
    systems = {side.domain_id: f"domain_{side.domain_id}" for side in (ping, relay)}
    topics = {
        name: {
            "type": types[options.type_of(name)],
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
                system: {"type": handle, "domain": domain_id, "node_name": f"dds_trace_bridge_{domain_id}", **using}
                for domain_id, system in systems.items()
            },
            "routes": {"ping_to_relay": {"from": there, "to": back}, "relay_to_ping": {"from": back, "to": there}},
            "topics": topics,
        }
    )


def _has_handle(name: str) -> bool:
    listed = [folder for variable in PREFIX_VARIABLES for folder in os.environ.get(variable, "").split(os.pathsep)]
    folders = [Path(folder) for folder in (*listed, *SYSTEM_PREFIXES) if folder]
    files = (f"{name}.mix", f"is/{name}.mix", f"is/{name}/{name}.mix")
    return any((folder / file).is_file() for folder in folders for file in files)


BRIDGE = Bridge(
    name=PROGRAM,
    install=(
        "build Integration-Service and ROS2-SH with colcon, either -DMIX_ROS_PACKAGES='std_msgs sensor_msgs' or "
        "-DIS_ROS2_SH_MODE=dynamic (https://integration-service.docs.eprosima.com), then source its install/setup.bash"
    ),
    tried="3.1.0 with the dynamic handle of ROS 2, November 2026; the static one never",
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
        # A depth makes keep_last of keep_all in the static handle.
        "history": {"kind": qos.history.upper(), **({} if qos.history == History.KEEP_ALL else {"depth": qos.depth})},
        **{
            policy: dict(zip(("sec", "nanosec"), divmod(duration_ns, SECOND_NS), strict=True))
            for policy, duration_ns in requested_durations(qos).items()
        },
    }
