"""`ros2`: nodes of the ROS 2 on this machine (Humble to Kilted, apt or wheels), with any middleware."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

from dds_trace.base.files import read_regular

from ...applied.vendors import VENDORS, RosMiddleware, ros_middleware
from ...choices import Call, Security, Transport
from ...host.environment import ConfigurationVariable, MiddlewareEnvironment
from ..base import Backend, Meeting, dds_meeting
from ..node import Node, NodeOptions
from . import installation
from .calls import Ros2CallNode
from .fastdds_profile import applied_transport
from .node import Ros2Node, running_rmw

_ROS_VARIABLES = ("RMW_IMPLEMENTATION", "ROS_DISTRO", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY")


def _make_node(options: NodeOptions) -> Node:
    """Open a node with its own context: several domains fit in one process."""
    if options.rmw is not None:
        os.environ["RMW_IMPLEMENTATION"] = options.rmw
    installation.check_installed()
    installation.set_discovery_range(options.discovery)
    installation.set_security(options)
    rmw = running_rmw()
    installation.check_vendor(options, rmw)
    with applied_transport(options, rmw) as settings, ExitStack() as undo:
        router = installation.open_router(rmw, options.discovery)
        undo.callback(router.close)
        kind = Ros2Node if options.call is Call.NONE else Ros2CallNode
        node = kind(options, {**settings, **router.settings}, on_closed=router.close)
        undo.pop_all()
        return node


def middleware_of(rmw: str | None) -> RosMiddleware:
    return ros_middleware(rmw or os.environ.get("RMW_IMPLEMENTATION") or installation.WHEELS_RMW)


def _variables_of(rmw: str | None, path: Path) -> dict[str, str]:
    vendor = middleware_of(rmw).vendor
    variables = {"cyclonedds": {"CYCLONEDDS_URI": path.as_uri()}, "zenoh": {"ZENOH_SESSION_CONFIG_URI": str(path)}}
    if vendor != "fastdds":
        return variables.get(vendor, {})
    # By default the RMW publishes in a way that no flow controller takes.
    is_paced = b"flow_controller_name" in read_regular(path)
    return {
        installation.fast_dds().profile_variables[0]: str(path),
        **({"RMW_FASTRTPS_PUBLICATION_MODE": "ASYNCHRONOUS"} if is_paced else {}),
    }


BACKEND = Backend(
    name="ros2",
    label="ROS 2",
    make_node=_make_node,
    find_installed=installation.find_rmws,
    describe_installed=installation.describe_installed,
    install=installation.INSTALL,
    meeting=Meeting.DISCOVERY,
    meeting_needs=dds_meeting("else name each other's device in ROS_STATIC_PEERS, which ROS 2 Iron and later read"),
    own_causes=installation.own_causes,
    speaks_dds=True,
    security=tuple(level for level in Security if level is not Security.OFF),
    has_ros=True,
    calls=(Call.SERVICE, Call.ACTION),
    transports=(Transport.DEFAULT, Transport.UDP, Transport.SHM, Transport.LARGE_DATA),
    sizes={
        Transport.DEFAULT: ("buffer", "segment", "fragment"),
        Transport.UDP: ("buffer", "fragment"),
        Transport.SHM: ("segment",),
    },
    environment=MiddlewareEnvironment(
        settings=(*_ROS_VARIABLES, *(name for facts in VENDORS.values() for name in facts.variables)),
        configuration=(
            *(ConfigurationVariable(name) for name in installation.fast_dds().profile_variables),
            ConfigurationVariable("CYCLONEDDS_URI", ","),
        ),
        files=(installation.fast_dds().profile_file,),
    ),
    variables_of=_variables_of,
    profile_of=installation.profile_of,
    check_settings=installation.check_settings,
    missing_rmw=installation.missing_rmw,
)
