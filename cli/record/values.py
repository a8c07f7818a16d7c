"""What the options of `dds-record` mean as values, and what stands for one that is left out."""

from __future__ import annotations

import os
from typing import Any

from dds_trace.recorder import Discovery
from dds_trace.tracefile import OptionError
from dds_trace.tracefile.units.durations import parse_duration

DEFAULT_DOMAIN = 10


def default_domain() -> int:
    """ROS_DOMAIN_ID, else 10.

    Raises:
        OptionError: the variable is set to no number.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if not text:
        return DEFAULT_DOMAIN
    if not text.isdecimal():
        raise OptionError(f"ROS_DOMAIN_ID is {text!r}, which is no domain id; set a number or unset it")
    return int(text)


def default_discovery() -> Discovery:
    """What the environment of ROS 2 says, else the subnet."""
    is_local = (
        os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    )
    return Discovery.LOCALHOST if is_local else Discovery.SUBNET


def refuse_others(role: str, others: dict[str, Any]) -> None:
    """Refuse options that the other role alone has; they would be ignored, and their user believes otherwise.

    Args:
        role: this one.
        others: options of the other role by name, None for each that was not given.

    Raises:
        OptionError: naming those that were.
    """
    given = [name for name, value in others.items() if value is not None]
    if given:
        raise OptionError(f"{', '.join(given)} cannot be given to a {role}, only to the other role")


def parse_durations(**texts: str | None) -> dict[str, int]:
    """Those that were given, in ns."""
    return {name: parse_duration(text) for name, text in texts.items() if text is not None}


def parse_labels(texts: list[str]) -> dict[str, str]:
    """The labels in `KEY=VALUE` texts.

    Raises:
        OptionError: one of them has no key or no `=`.
    """
    labels = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise OptionError(f"--label {text!r}: write KEY=VALUE")
        labels[key] = value
    return labels
