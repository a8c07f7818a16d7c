"""What counts more than a default of `dds-trace.toml`: a variable of ROS 2, and the role that an option does not belong to."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

_OF_PING = (
    *(
        "data",
        "size",
        "seed",
        "rate",
        "messages",
        "warmup",
        "wait",
        "fail_if_lost",
        "relays",
        "bridge",
        "relay_domain",
    ),
    *("bridge_running", "bridge_listen", "bridge_peer", "label", "setting"),
)
_OF_RELAY = ("relay_id", "types", "rotate", "keep")

_VARIABLES = {
    "domain": ("ROS_DOMAIN_ID",),
    "relay_domain": ("ROS_DOMAIN_ID",),
    "discovery": ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"),
    "rmw": ("RMW_IMPLEMENTATION",),
}
"""Parameter -> the variables that tell it where no option does."""


def passes_over(values: Mapping[str, Any]) -> dict[str, str]:
    """Return name of a parameter -> why its default in a file does not count.

    Args:
        values: name of each parameter -> its value.
    """
    role = getattr(values.get("role"), "value", values.get("role"))
    foreign = {"ping": _OF_RELAY, "relay": _OF_PING}.get(role or "", ())
    is_bridged = role != "relay" and values.get("bridge") not in (None, "none")
    found = dict.fromkeys(foreign, f"default: not of a {role}")
    for name, variables in _VARIABLES.items():
        given = next((variable for variable in variables if os.environ.get(variable)), None)
        # The domain of a ping behind a bridge is never that of the environment.
        if given is not None and name not in found and not (name == "domain" and is_bridged):
            found[name] = f"environment: {given}={os.environ[given]}"
    return found
