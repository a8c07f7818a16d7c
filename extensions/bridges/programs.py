"""Where other projects' programs are installed, their version and environment."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from dds_trace.recorder.choices import Discovery

from .base import BridgeOptions

VERSION_TIMEOUT_S = 10.0

_WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def program_on_path(name: str, folder: Path | None = None) -> Path | None:
    path = shutil.which(name, path=None if folder is None else str(folder))
    return Path(path) if path else None


def reported_version(program: Path, *arguments: str) -> str:
    try:
        completed = subprocess.run(
            [str(program), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=program_environment({"RUST_LOG": "off"}, foreign=True),  # zenoh logs to the same output
            timeout=VERSION_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return next((line.strip() for line in completed.stdout.splitlines() if re.search(r"\d+\.\d+", line)), "")


def discovery_environment(options: BridgeOptions) -> Mapping[str, str]:
    localhost = options.discovery is Discovery.LOCALHOST
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST" if localhost else "SUBNET",
        "ROS_LOCALHOST_ONLY": "1" if localhost else "0",
    }


def program_environment(extra: Mapping[str, str], *, foreign: bool) -> dict[str, str]:
    """Return a program's environment; a `foreign` one lacks the library path of the ROS 2 wheels."""
    variables = {**os.environ, **extra}
    if foreign and variables.pop(_WHEELS_GUARD, ""):
        paths = variables.pop("LD_LIBRARY_PATH", "").split(os.pathsep)
        others = [path for path in paths if path and not Path(path).is_relative_to(sys.prefix)]
        if others:
            variables["LD_LIBRARY_PATH"] = os.pathsep.join(others)
    return variables
