"""Values of the options of `dds-record`: parsed from their texts, and defaults from the environment."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import shown
from dds_trace.base.units import parse_duration, parse_size, split_quantity
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.options import KeepFree, Rotation

if TYPE_CHECKING:
    from collections.abc import Mapping

DEFAULT_DOMAIN = 10
AGE_UNITS_S = {"s": 1, "min": 60, "h": 3600, "d": 86_400}
"""Unit of a file's age -> its seconds."""


def default_domain() -> int:
    """Return ROS_DOMAIN_ID, or 10 if it is unset.

    Raises:
        OptionError: the variable is set to something that is no number.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if not text:
        return DEFAULT_DOMAIN
    if not text.isdecimal() or len(text) > 9:
        raise OptionError(f"ROS_DOMAIN_ID is {shown(text)}, which is no domain id; set a number or unset it")
    return int(text)


def default_discovery() -> Discovery:
    """Return the discovery range of ROS 2's environment, or the subnet if it says nothing."""
    is_local = (
        os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    )
    return Discovery.LOCALHOST if is_local else Discovery.SUBNET


def refuse_others(role: str, others: Mapping[str, object]) -> None:
    """Refuse options that only the other role has, instead of ignoring them.

    Args:
        role: the role that records.
        others: options of the other role by name, None for each that was not given.

    Raises:
        OptionError: at least one was given; the message names all of them.
    """
    given = [name for name, value in others.items() if value is not None]
    if given:
        raise OptionError(
            f"{', '.join(given)} cannot be given to a {role}, only to the other role; leave {'it' if len(given) == 1 else 'them'} out"
        )


def parse_percentage(option: str, text: str) -> float:
    """Return the share, 0 to 1, that a text like `1%` or `0.5 %` means.

    Args:
        option: name of the option, for errors.
        text: its value.

    Raises:
        OptionError: the text is no percentage from 0 to 100.
    """
    number = text.strip().removesuffix("%").strip()
    try:
        share = float(number) / 100
    except ValueError:
        share = -1.0
    if not text.strip().endswith("%") or not 0 <= share <= 1:
        raise OptionError(f"{option} {text!r}: write a percentage from 0% to 100%, for example 1%")
    return share


def parse_durations(**texts: str | None) -> dict[str, int]:
    """Return the given durations in ns, without those that are None."""
    return {name: parse_duration(text) for name, text in texts.items() if text is not None}


def parse_pairs(option: str, texts: list[str], example: str) -> dict[str, str]:
    """Return keys and values of `KEY=VALUE` texts.

    Args:
        option: name of the option, for errors.
        texts: its values.
        example: a right one, for errors.

    Raises:
        OptionError: a text has no key or no `=`.
    """
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise OptionError(f"{option} {text!r}: write KEY=VALUE, for example {example}")
        pairs[key] = value
    return pairs


def parse_rotation(rotate: str | None, keep: int | None) -> Rotation | None:
    """Return what `--rotate` and `--keep` ask for: a size, an age, or both with a comma between.

    Raises:
        OptionError: a part is neither, or `--keep` stands alone.
    """
    if rotate is None:
        if keep is not None:
            raise OptionError(
                "--keep counts the files of --rotate: give both, for example --rotate 1GB,1h --keep 20"
            )
        return None
    file_bytes: int | None = None
    age_s: float | None = None
    for part in rotate.split(","):
        value, unit = split_quantity(part.strip()) or (0.0, "")
        if unit in AGE_UNITS_S and age_s is None:
            age_s = value * AGE_UNITS_S[unit]
        elif unit.endswith("b") and file_bytes is None:
            file_bytes = parse_size(part.strip(), "--rotate")
        else:
            raise OptionError(
                f"--rotate {shown(rotate)}: write a size, an age (s, min, h, d) or both: 1GB, 1h, 1GB,1h"
            )
    return Rotation(file_bytes, age_s, keep)


def parse_keep_free(text: str | None) -> KeepFree:
    """Return what `--keep-free` asks for: a size, or a share of the disk.

    Raises:
        OptionError: the text is neither.
    """
    if text is None:
        return KeepFree()
    if text.strip().endswith("%"):
        return KeepFree(parse_percentage("--keep-free", text), None)
    return KeepFree(1.0, parse_size(text, "--keep-free"))
