"""Finding other people's programs and asking them for their version."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

from ...choices import Discovery
from .supervise import program_environment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..base import BridgeOptions

VERSION_TIMEOUT_S = 10.0


def reported_version(program: Path, *arguments: str) -> str:
    """The first line with something like a version in what the program prints.

    Empty if it prints none, fails to start, or does not end in time: the version is worth having, not worth failing.
    """
    try:
        ran = subprocess.run(
            [str(program), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=program_environment({"RUST_LOG": "off"}, foreign=True),  # zenoh logs to where it answers
            timeout=VERSION_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return next((line.strip() for line in ran.stdout.splitlines() if re.search(r"\d+\.\d+", line)), "")


def ros_package_program(package: str, program: str) -> Path | None:
    """`lib/PACKAGE/PROGRAM` of the sourced ROS 2 installations, None if none has it."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        found = Path(prefix) / "lib" / package / program
        if prefix and os.access(found, os.X_OK) and found.is_file():
            return found
    return None


def ros_package_version(program: Path, package: str) -> str:
    """Version of the package that `program` (`PREFIX/lib/PACKAGE/PROGRAM`) belongs to, empty if it is not told."""
    manifest = program.parents[2] / "share" / package / "package.xml"
    try:
        found = re.search(r"<version>\s*([^<\s]+)", manifest.read_text())
    except OSError:
        return ""
    return found[1] if found else ""


def discovery_environment(options: BridgeOptions) -> Mapping[str, str]:
    """Tells a program with a ROS 2 inside how far to look for nodes: the variables of Jazzy and of Humble."""
    localhost = options.discovery is Discovery.LOCALHOST
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST" if localhost else "SUBNET",
        "ROS_LOCALHOST_ONLY": "1" if localhost else "0",
    }
