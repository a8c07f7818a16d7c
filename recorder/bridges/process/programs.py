"""Programs of other projects: where they are installed, their version and their environment."""

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

    from ..options import BridgeOptions

VERSION_TIMEOUT_S = 10.0


def reported_version(program: Path, *arguments: str) -> str:
    """Return the first printed line of a program that holds a version.

    Empty if there is no such line, or if the program fails to start or to end in time: a missing version must not end
    a recording.
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
    """Return `lib/PACKAGE/PROGRAM` of the sourced ROS 2 installations, None if no installation has it."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "lib" / package / program
        if prefix and os.access(path, os.X_OK) and path.is_file():
            return path
    return None


def ros_package_version(program: Path, package: str) -> str:
    """Return the version of the package of `program` (`PREFIX/lib/PACKAGE/PROGRAM`), empty if its manifest has none."""
    manifest = program.parents[2] / "share" / package / "package.xml"
    try:
        match = re.search(r"<version>\s*([^<\s]+)", manifest.read_text())
    except OSError:
        return ""
    return match[1] if match else ""


def discovery_environment(options: BridgeOptions) -> Mapping[str, str]:
    """Return the discovery range for a program with a ROS 2 inside: the variables of Jazzy and of Humble."""
    localhost = options.discovery is Discovery.LOCALHOST
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST" if localhost else "SUBNET",
        "ROS_LOCALHOST_ONLY": "1" if localhost else "0",
    }
