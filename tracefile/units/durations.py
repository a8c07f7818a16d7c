"""Durations as people write them: `20ms`, `1.5s`, `500us`."""

from __future__ import annotations

import re

from .. import OptionError

SECOND_NS = 1_000_000_000
UNIT_NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": SECOND_NS}
INFINITE_NS = (2**31 - 1) * SECOND_NS
"""From here on a duration of DDS is one without end: its seconds are a signed 32-bit integer (RTPS 2.5, section 9.3.2)."""
_DURATION = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(ns|us|ms|s)\s*")


def parse_duration(text: str) -> int:
    """The ns that `text` means, at least 1.

    Raises:
        OptionError: it is no duration.
    """
    match = _DURATION.fullmatch(text)
    duration_ns = round(float(match[1]) * UNIT_NS[match[2]]) if match else 0
    if not 0 < duration_ns < INFINITE_NS:
        raise OptionError(f"duration {text!r} is not understood; write 20ms, 1.5s or 500us, more than 0")
    return duration_ns


def format_duration(duration_ns: int) -> str:
    """`duration_ns` with the largest unit that leaves a whole part: `20ms`."""
    unit = next((unit for unit in ("s", "ms", "us") if duration_ns >= UNIT_NS[unit]), "ns")
    return f"{duration_ns / UNIT_NS[unit]:g}{unit}"
