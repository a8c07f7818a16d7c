"""Which middlewares this machine has, found without loading any of them."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from ...backends import BACKEND_MODULES

if TYPE_CHECKING:
    from collections.abc import Callable

RMW_INDEX = Path("share/ament_index/resource_index/rmw_typesupport")
"""Where every RMW package of a ROS 2 installation leaves a file with its name."""


def installed_middlewares() -> list[tuple[str, str | None]]:
    """(backend, rmw) of every middleware that could be recorded here; rmw None is the environment's own choice."""
    return [(name, rmw) for name in BACKEND_MODULES if name in _FOUND for rmw in _FOUND[name]()]


def _rmws() -> list[str | None]:
    if not _has("rclpy"):
        return []
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    found = {file.name for prefix in prefixes for file in Path(prefix, RMW_INDEX).glob("rmw_*")}
    return [*sorted(found)] or [None]  # the wheels have no index, and one RMW built in


def _connext() -> list[str | None]:
    # Without a licence its participants cannot be made.
    return [None] if _has("rti") and os.environ.get("RTI_LICENSE_FILE") else []


def _has(package: str) -> bool:
    return find_spec(package) is not None


_FOUND: dict[str, Callable[[], list[str | None]]] = {
    "ros2": _rmws,
    "cyclonedds": lambda: [None] if _has("cyclonedds") else [],
    "zenoh": lambda: [None] if _has("zenoh") else [],
    "connext": _connext,
    "socket": lambda: [None],
}
