"""Ping and relay, both on this machine or one of them: `ros2 launch dds_trace ping_relay.launch.py size:=33KB rate:=50`.

The launch ends when the ping does; the relay then gets SIGINT and closes its trace. What is not given is left to `record`.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, ExecuteProcess, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

if TYPE_CHECKING:
    from launch import LaunchContext
    from launch.action import Action

BOTH = ("domain", "rmw", "discovery")
"""Options of `record` that ping and relay share."""

OF_PING = ("data", "size", "rate", "messages")
"""Options of the ping alone."""

ARGUMENTS = {
    "role": ("both", "Roles to start: both, ping or relay."),
    "out": ("runs/launch", "Folder of the traces ping.mcap and relay.mcap, which must not be there yet."),
    "domain": ("", "DDS domain; ROS_DOMAIN_ID if not given."),
    "rmw": ("", "RMW implementation, such as rmw_cyclonedds_cpp; RMW_IMPLEMENTATION if not given."),
    "discovery": ("", "localhost or subnet; what ROS 2's variables say if not given."),
    "data": ("", "binary, string, imu, imu:FILE, file:PATH, bag:PATH#TOPIC or topic:/NAME."),
    "size": ("", "Size of a message, such as 33KB."),
    "rate": ("", "Messages a second."),
    "messages": ("", "Messages to measure."),
    "ping_options": ("", "Further options of the ping, as one would type them."),
    "relay_options": ("", "Further options of the relay."),
}
"""Argument -> default and meaning."""


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and the processes that they ask for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=processes)])


def processes(context: LaunchContext) -> list[Action]:
    """Return the relay and the ping that were asked for, and the end of the launch with the ping."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    started: list[Action] = []
    if given["role"] in ("both", "relay"):
        started.append(_record("relay", given, BOTH))
    if given["role"] in ("both", "ping"):
        ping = _record("ping", given, BOTH + OF_PING)
        the_end = EmitEvent(event=Shutdown(reason="the ping has ended"))
        started += [ping, RegisterEventHandler(OnProcessExit(target_action=ping, on_exit=[the_end]))]
    if not started:
        raise ValueError(f"role:={given['role']} is none of both, ping and relay")
    return started


def _record(role: str, given: dict[str, str], names: tuple[str, ...]) -> ExecuteProcess:
    """Return the process of a role: the executable itself, since `ros2 run` does not hand a signal on."""
    options = [word for name in names if given[name] for word in (f"--{name}", given[name])]
    return ExecuteProcess(
        cmd=[
            ExecutableInPackage(executable="record", package="dds_trace"),
            *("--role", role, "--out", str(Path(given["out"]) / f"{role}.mcap")),
            *options,
            *shlex.split(given[f"{role}_options"]),
        ],
        name=f"dds_trace_{role}",
        output="screen",
        sigterm_timeout="30",  # a trace takes its time to close
    )
