"""The ROS 2 of this machine, looked at and set up without importing it: what is installed, vendors, environment."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import suppress
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError

from ...applied.vendors import VENDORS, ros_middleware
from ...choices import Discovery, Transport
from ..qos import DURATION_POLICIES, requested_durations
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


NO_TUNING = (
    "no settings for large messages are known for the transport {}: --tuned enlarges the buffers of UDP sockets, which do "
    "not carry them there; leave one of the two options out"
)


def find_rmws() -> Sequence[str | None]:
    """Return the ROS middlewares of this machine, `[None]` for wheels with their only one, nothing without rclpy."""
    if not has_package("rclpy"):
        return []
    names = {file.name for prefix in _prefixes() for file in Path(prefix, RMW_INDEX).glob("rmw_*")}
    return sorted(names) or [None]  # the wheels have no index, and one RMW built in


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
    asked = (options.transport.value, options.tuned)
    builtin = VENDORS["fastdds"].builtin_transports
    if asked not in builtin:
        raise OptionError(NO_TUNING.format(options.transport.value))
    check_vendor(options, rmw)
    if (value := builtin[asked]) is not None:
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = value


def check_settings(options: NodeOptions) -> None:
    """Refuse settings of one vendor on the ROS middleware that is asked for by name, before anything is opened.

    Raises:
        OptionError: naming the setting and the middleware.
    """
    if options.rmw is not None:
        check_vendor(options, options.rmw)


def check_vendor(options: NodeOptions, rmw: str) -> None:
    """Refuse settings that the vendor of a ROS middleware does not have.

    Raises:
        OptionError: naming the setting and the middleware.
    """
    known = ros_middleware(rmw)
    if known.vendor != "fastdds":
        if options.transport is not Transport.DEFAULT:
            raise OptionError(
                f"--transport {options.transport.value} is Fast DDS's, and the middleware here is {rmw}; leave it out"
            )
        if options.tuned:
            raise OptionError(
                f"--tuned: no settings for large messages of {rmw} are known here; leave it out, or give them by its own files"
            )
    durations = [policy for policy in DURATION_POLICIES if policy in requested_durations(options.qos)]
    if durations and not known.has_durations:
        raise OptionError(f"--{durations[0]}: {rmw} does not implement it; leave it out")


def package_version(package: str) -> str | None:
    """Return the version of a ROS package, wherever this installation tells it; None if nowhere.

    From its wheel, its `package.xml`, the version file that CMake reads (minimal images leave `package.xml` out), or dpkg.
    """
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(f"ros-{package.replace('_', '-')}")
    for prefix in _prefixes():
        for file, version in _VERSION_FILES:
            with suppress(OSError):
                if found := version.search(Path(prefix, file.format(package=package)).read_text()):
                    return found[1]
    return _debian_version(package)


_VERSION_FILES = (
    ("share/{package}/package.xml", re.compile(r"<version>\s*([^<\s]+)")),
    (
        "share/{package}/cmake/{package}Config-version.cmake",
        re.compile(r'set\(\s*PACKAGE_VERSION\s+"([^"]+)"', re.IGNORECASE),
    ),
)
"""File below a prefix of the installation, and the version in it."""

DPKG_STATUS = Path("/var/lib/dpkg/status")


def _debian_version(package: str) -> str | None:
    """Return the version of the Debian package `ros-DISTRO-PACKAGE`, without its revision."""
    distro = os.environ.get("ROS_DISTRO", "")
    name = f"ros-{distro}-{package.replace('_', '-')}"
    with suppress(OSError):
        pattern = rf"^Package: {re.escape(name)}\n(?:[^\n]+\n)*?Version: (?:\d+:)?([^\n-]+)"
        if distro and (found := re.search(pattern, DPKG_STATUS.read_text(errors="replace"), re.MULTILINE)):
            return found[1]
    return None


def _prefixes() -> list[str]:
    return [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
