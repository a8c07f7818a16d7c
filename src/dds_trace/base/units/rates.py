"""Rates of messages: read as people write them (`20`, `2.5Hz`, `1kHz`) and written for people."""

from __future__ import annotations

from ..errors import OptionError
from ..limits import shown
from .quantities import format_quantity, split_quantity

UNIT_HZ = {"": 1, "hz": 1, "khz": 1000}
"""Unit in lower case -> its Hz."""


def parse_rate(text: str, what: str = "rate") -> float:
    """Read a rate in Hz.

    Args:
        text: a number alone, or with one of the units Hz and kHz.
        what: the name of the value in the error.

    Raises:
        OptionError: `text` is no rate, or 0.
    """
    value, unit = split_quantity(text) or (0.0, "")
    rate_hz = value * UNIT_HZ.get(unit, 0)
    if not rate_hz:
        raise OptionError(f"{what} {shown(text)} is not understood; write 20, 2.5Hz or 1kHz, more than 0")
    return rate_hz


def format_rate(value_hz: float | None) -> str:
    """Write a rate to three digits: `10 Hz`; `MISSING` for None, an infinite one and NaN."""
    return format_quantity(value_hz, {"Hz": 1})
