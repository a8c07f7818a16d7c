"""Finding other people's programs and asking them for their version."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

VERSION_TIMEOUT_S = 10.0


def reported_version(program: Path, *arguments: str) -> str:
    """The first thing like a version in what the program prints, with what stands around it on its line.

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
