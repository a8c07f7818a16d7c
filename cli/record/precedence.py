"""Why a configured default is overridden: by a variable of ROS 2, or by the role."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import shown
from dds_trace.recorder.choices import Discovery, Role
from dds_trace.recorder.option_table import OPTIONS

DEFAULT_DOMAIN = 10


def overridden(values: Mapping[str, Any]) -> dict[str, str]:
    role = None if values.get("role") is None else Role(values["role"])
    is_bridged = role in (None, Role.PING) and values.get("bridge") not in (None, "none")
    reasons = {}
    for name, row in OPTIONS.items():
        variable = next((variable for variable in row.variables if os.environ.get(variable)), None)
        if name == "duration_s" and values.get("for_s") is not None:
            reasons[name] = "option: --for"
        elif role and row.roles and role not in row.roles:
            reasons[name] = f"default: not of a {role.value}"
        # The domain of a ping with a bridge is never from the environment.
        elif variable is not None and not (name == "domain_id" and is_bridged):
            reasons[name] = f"environment: {variable}={os.environ[variable]}"
    return reasons


def default_domain() -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if not text:
        return DEFAULT_DOMAIN
    if not text.isdecimal() or len(text) > 9:
        raise OptionError(f"ROS_DOMAIN_ID is {shown(text)}, not a domain id; set a number or unset it")
    return int(text)


def default_discovery(*, is_open: bool = True) -> Discovery:
    """Return the discovery range of ROS 2's environment, by default the subnet, or this machine unless `is_open`."""
    is_local = (
        os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    )
    is_asked = is_open or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "SUBNET"
    return Discovery.LOCALHOST if is_local or not is_asked else Discovery.SUBNET
