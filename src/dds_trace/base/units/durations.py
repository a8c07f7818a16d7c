"""Durations: read as people write them (`20ms`, `1.5s`, `500us`), written for people and for the command line."""

from __future__ import annotations

from ..errors import OptionError
from ..limits import shown
from .quantities import format_quantity, split_quantity

SECOND_NS = 1_000_000_000
UNIT_NS = {"s": SECOND_NS, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""Unit as the command line takes it -> its ns."""

INFINITE_NS = (2**31 - 1) * SECOND_NS
"""Shortest duration that DDS takes as infinite: its seconds are a signed 32-bit integer (RTPS 2.5, section 9.3.2)."""

_SHOWN_NS = {"s": SECOND_NS, "ms": 1_000_000, "µs": 1_000, "ns": 1}
_READ_NS = UNIT_NS | _SHOWN_NS


def parse_duration(text: str, what: str = "duration") -> int:
    """Read a duration in ns.

    Args:
        text: a number and one of the units ns, us, µs, ms and s.
        what: the name of the value in the error.

    Raises:
        OptionError: `text` is no duration, is shorter than half a nanosecond, or is `INFINITE_NS` or longer.
    """
    value, unit = split_quantity(text) or (0.0, "")
    duration_ns = round(value * _READ_NS.get(unit, 0))
    if not 0 < duration_ns < INFINITE_NS:
        raise OptionError(f"{what} {shown(text)} is not understood; write 20ms, 1.5s or 500us, more than 0")
    return duration_ns


def format_duration(value_ns: float | None, unit: str | None = None) -> str:
    """Write a duration to three digits: `812 ns`, `1.25 ms`; `MISSING` for None, an infinite one and NaN.

    Args:
        value_ns: the duration, which may be negative.
        unit: the one unit of `UNIT_NS` to write it in; else the one that leaves one to three digits before the point.
    """
    return format_quantity(value_ns, _SHOWN_NS if unit is None else {unit: UNIT_NS[unit]})


def format_ms(value_ns: float) -> str:
    """Write a duration in ms with three decimals and without the unit, for tables and texts that keep to ms: `1.250`."""
    return f"{value_ns / 1e6:.3f}"


def spell_duration(duration_ns: int, digits: int = 15) -> str:
    """Write a duration to `digits` digits, as `parse_duration` reads it, in the largest unit that it fills: `20ms`."""
    unit = next((unit for unit, factor in UNIT_NS.items() if duration_ns >= factor), "ns")
    return f"{duration_ns / UNIT_NS[unit]:.{digits}g}{unit}"
