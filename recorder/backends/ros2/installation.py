"""The ROS 2 of this machine, looked at and set up without importing it: what is installed, vendors, environment."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.tracefile import BackendUnavailableError, OptionError

from ...choices import Discovery, Transport
from ..threaded import has_package

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..node import NodeOptions

WRONG_RMW_TIMEOUT_S = 30.0
RMW_INDEX = Path("share/ament_index/resource_index/rmw_typesupport")
"""Folder in which every RMW package of a ROS 2 installation leaves a file with its name."""

INSTALL = (
    "pip install 'dds-trace[ros2]' (wheels, x86_64), or install ROS 2 from apt and run "
    "`source /opt/ros/$ROS_DISTRO/setup.bash` in this terminal (the Python of that ROS 2 must run dds-trace)"
)


@dataclass(frozen=True, slots=True)
class Vendor:
    """The vendor behind a ROS middleware.

    Attributes:
        name: vendor, as in a session.
        label: name for people.
        packages: ROS packages whose versions describe it.
        stamps_reception: whether its `received_timestamp` is the time of the reception; False where it is that of the take.
    """

    name: str
    label: str
    packages: tuple[str, ...]
    stamps_reception: bool = True


VENDORS = {
    "rmw_fastrtps_cpp": Vendor("fastdds", "Fast DDS", ("fastrtps", "fastdds", "rmw_fastrtps_cpp")),
    "rmw_fastrtps_dynamic_cpp": Vendor(
        "fastdds", "Fast DDS", ("fastrtps", "fastdds", "rmw_fastrtps_dynamic_cpp")
    ),
    # Its source fills `received_timestamp` when the message is taken (a TODO in rmw_node.cpp, take_with_info).
    "rmw_cyclonedds_cpp": Vendor(
        "cyclonedds", "Cyclone DDS", ("cyclonedds", "rmw_cyclonedds_cpp"), stamps_reception=False
    ),
    "rmw_connextdds": Vendor("connext", "RTI Connext", ("rti_connext_dds_cmake_module", "rmw_connextdds")),
    "rmw_zenoh_cpp": Vendor("zenoh", "Zenoh", ("zenoh_cpp_vendor", "rmw_zenoh_cpp")),
}

FASTDDS_TRANSPORTS = {
    (Transport.DEFAULT, False): None,
    (Transport.UDP, False): "UDPv4",
    (Transport.SHM, False): "SHM",
    (Transport.LARGE_DATA, False): "LARGE_DATA",
    (Transport.DEFAULT, True): "UDPv4?sockets_size=4MB",
    (Transport.UDP, True): "UDPv4?sockets_size=4MB",
}
"""(transport, tuned) -> value of FASTDDS_BUILTIN_TRANSPORTS; None leaves the user's own value in place."""


NO_TUNING = (
    "no settings for large messages are known for the transport {}: --tuned enlarges the buffers of UDP sockets, which do "
    "not carry them there; leave one of the two options out"
)


def find_rmws() -> Sequence[str | None]:
    """Return the ROS middlewares of this machine, `[None]` for wheels with their only one, nothing without rclpy."""
    if not has_package("rclpy"):
        return []
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    names = {file.name for prefix in prefixes for file in Path(prefix, RMW_INDEX).glob("rmw_*")}
    return sorted(names) or [None]  # the wheels have no index, and one RMW built in


def vendor_of(rmw: str) -> Vendor:
    """Return the vendor of the ROS middleware `rmw`; that of an unknown one has its name."""
    name = rmw.removeprefix("rmw_").removesuffix("_cpp")
    return VENDORS.get(rmw, Vendor(name, name, (rmw,)))


def check_installed() -> None:
    """Refuse to go on without rclpy, or with a ROS middleware that it does not run on.

    Raises:
        BackendUnavailableError: naming what is missing.
    """
    if not has_package("rclpy"):
        raise BackendUnavailableError(f"ROS 2's Python client rclpy is not installed; {INSTALL}")
    wanted = os.environ.get("RMW_IMPLEMENTATION")
    if not wanted or "rclpy" in sys.modules:
        return
    # With a middleware that it was not built for, rclpy ends the whole process (status 102) as soon as it is
    # imported; so another process tries it first.
    ask = "from rclpy.utilities import get_rmw_implementation_identifier as name; print(name())"
    tried = subprocess.run(
        [sys.executable, "-c", ask], capture_output=True, text=True, timeout=WRONG_RMW_TIMEOUT_S, check=False
    )
    running = tried.stdout.strip()
    if running != wanted:
        reason = (tried.stderr.strip().splitlines() or [f"{running} is what runs here"])[-1]
        raise BackendUnavailableError(
            f"RMW_IMPLEMENTATION={wanted} does not work here: {reason}; unset it, or install that middleware "
            f"(apt install ros-$ROS_DISTRO-{wanted.replace('_', '-')}; the wheels have Fast DDS alone)"
        )


def set_discovery_range(discovery: Discovery) -> None:
    """Set the environment variable from which a context reads how far its nodes look for others."""
    is_local = discovery is Discovery.LOCALHOST
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST" if is_local else "SUBNET"
    # Iron and later know the range, and warn when they meet the older variable; Humble knows that one alone.
    if find_spec("rclpy.event_handler") is None:
        os.environ["ROS_LOCALHOST_ONLY"] = "1" if is_local else "0"
    else:
        os.environ.pop("ROS_LOCALHOST_ONLY", None)


def set_transport(options: NodeOptions, rmw: str) -> None:
    """Set the environment variable from which Fast DDS reads its transports when a node is made, beyond this machine.

    Args:
        options: options of the node.
        rmw: identifier of the running ROS middleware.

    Raises:
        OptionError: the middleware is not Fast DDS, or no settings for large messages are known for the transport.
    """
    chosen = (options.transport, options.tuned)
    if chosen not in FASTDDS_TRANSPORTS:
        raise OptionError(NO_TUNING.format(options.transport.value))
    if (value := FASTDDS_TRANSPORTS[chosen]) is not None:
        if vendor_of(rmw).name != "fastdds":
            raise OptionError(f"transport and tuning are Fast DDS's, and the middleware here is {rmw}")
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = value


def package_version(package: str) -> str | None:
    """Return the version of a ROS package, from its wheel or the installation's `package.xml`; None if it is not here."""
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(f"ros-{package.replace('_', '-')}")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        with suppress(OSError):
            text = (Path(prefix) / "share" / package / "package.xml").read_text()
            if version := re.search(r"<version>\s*([^<\s]+)", text):
                return version[1]
    return None
