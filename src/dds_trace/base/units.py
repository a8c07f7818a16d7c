"""Numbers with units, as people write them (`20ms`, `33KB`, `1kHz`)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timezone

from .errors import OptionError
from .limits import shown

MISSING = "-"
"""Text in place of a number that does not exist; 0 would be a measurement."""

SECOND_NS = 1_000_000_000
UNIT_NS = {"s": SECOND_NS, "ms": 1_000_000, "us": 1_000, "ns": 1}

DRIFT_LIMIT_PPB = 1_100_000
"""Largest drift of two clocks: Linux slews each by at most 500 ppm (adjtimex(2)); their crystals part by under 100 ppm more."""

INFINITE_NS = (2**31 - 1) * SECOND_NS
"""Shortest duration that DDS takes as infinite: its seconds are a signed 32-bit integer (RTPS 2.5, section 9.3.2)."""

UNIT_HZ = {"": 1, "hz": 1, "khz": 1000}

_READ_NS = UNIT_NS | {"µs": 1_000}
SHOWN_NS = {"d": 86_400 * SECOND_NS, "h": 3_600 * SECOND_NS, "s": SECOND_NS, "ms": 1_000_000, "µs": 1_000, "ns": 1}
DECIMAL_BYTES = {"GB": 10**9, "MB": 10**6, "KB": 10**3, "B": 1}
_BINARY_BYTES = {"GiB": 2**30, "MiB": 2**20, "KiB": 2**10}
UNIT_BYTES = {"": 1} | {unit.lower(): size for unit, size in (DECIMAL_BYTES | _BINARY_BYTES).items()}
"""A number without unit is bytes."""

_QUANTITY = re.compile(r"\s*(\d{1,30}(?:\.\d{0,30})?|\.\d{1,30})\s*([a-zµ%]*)\s*", re.IGNORECASE | re.ASCII)


_NUMBER = re.compile(r"(\d+(?:\.\d+)?)", re.ASCII)


def by_number(text: str) -> tuple[tuple[str | float, ...], str]:
    return tuple(float(part) if index % 2 else part for index, part in enumerate(_NUMBER.split(text))), text


def counted(count: float, singular: str, many: str = "") -> str:
    return f"{count:,} {singular if count == 1 else many or f'{singular}s'}"


def first_of(lines: Sequence[str], most: int, more: str = "more") -> list[str]:
    """Return the first, and how many more."""
    return [*lines[:most], *([f"and {len(lines) - most:,} {more}"] if len(lines) > most else [])]


def split_quantity(text: str) -> tuple[float, str] | None:
    """Split `1.5 ms` into number (no sign, no exponent) and unit in lower case; None if `text` is no quantity."""
    match = _QUANTITY.fullmatch(text)
    return None if match is None else (float(match[1]), match[2].lower())


def format_quantity(value: float | None, units: Mapping[str, float]) -> str:
    if value is None or not math.isfinite(value):
        return MISSING
    # 999.96 would be written as 1000: the larger unit takes it.
    unit = next((unit for unit, factor in units.items() if abs(value) >= 0.9995 * factor), [*units][-1])
    return f"{three_digits(value / units[unit])} {unit}"


def finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def three_digits(value: float) -> str:
    if value == 0:
        return "0"
    decimals = max(0, 2 - math.floor(math.log10(abs(value)) + 1e-12))
    digits = f"{value:.{min(decimals, 9)}f}"
    return digits.rstrip("0").rstrip(".") if "." in digits else digits


def format_number(value: float) -> str:
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.0f}" if abs(rounded) >= 1000 else three_digits(rounded)


def parse_duration(text: str, what: str = "duration") -> int:
    """Read a duration (ns, us, µs, ms, s) below `INFINITE_NS`, in ns; `what` names it in the `OptionError`."""
    value, unit = split_quantity(text) or (0.0, "")
    duration_ns = round(value * _READ_NS.get(unit, 0))
    if not 0 < duration_ns < INFINITE_NS:
        raise OptionError(f"{what} {shown(text)} is not understood; write 20ms, 1.5s or 500us, more than 0")
    return duration_ns


def format_duration(value_ns: float | None, unit: str | None = None) -> str:
    return format_quantity(value_ns, SHOWN_NS if unit is None else {unit: SHOWN_NS[unit]})


def spell_duration(duration_ns: int, digits: int = 15) -> str:
    unit = next((unit for unit, factor in UNIT_NS.items() if duration_ns >= factor), "ns")
    return f"{duration_ns / UNIT_NS[unit]:.{digits}g}{unit}"


def parse_rate(text: str, what: str = "rate") -> float:
    """Read a rate (no unit, Hz, kHz) above 0, in Hz; `what` names it in the `OptionError`."""
    value, unit = split_quantity(text) or (0.0, "")
    rate_hz = value * UNIT_HZ.get(unit, 0)
    if not rate_hz:
        raise OptionError(f"{what} {shown(text)} is not understood; write 20, 2.5Hz or 1kHz, more than 0")
    return rate_hz


def format_rate(value_hz: float | None) -> str:
    """Write a rate to three digits, `10 Hz`; 0 is `max`, as fast as the middleware takes messages."""
    return "max" if value_hz == 0 else format_quantity(value_hz, {"Hz": 1})


def parse_size(text: str, what: str = "size") -> int:
    """Read a whole number of bytes; KB is 1000, KiB 1024. `what` names it in the `OptionError`."""
    value, unit = split_quantity(text) or (0.0, "?")
    if unit not in UNIT_BYTES:
        raise OptionError(
            f"{what} {shown(text)} is not understood; write bytes, or 33KB, 4MB (1000), 1KiB, 2MiB (1024)"
        )
    size_bytes = round(value * UNIT_BYTES[unit], 3)  # 529469.7 KB is 529469699.99999994 B in floats
    if size_bytes != int(size_bytes):
        raise OptionError(f"{what} {shown(text)} is not a whole number of bytes")
    return int(size_bytes)


def format_size(size_bytes: int) -> str:
    for unit, factor in DECIMAL_BYTES.items():
        if size_bytes >= factor > 1 and size_bytes % (factor / 10) == 0:
            return f"{size_bytes / factor:.15g} {unit}"
    for unit, factor in _BINARY_BYTES.items():
        if size_bytes >= factor and size_bytes % factor == 0:
            return f"{size_bytes // factor} {unit}"
    return f"{size_bytes} B"


def mean_size(size_bytes: float) -> str:
    return format_size(int(float(f"{size_bytes:.3g}")))


def spell_size(size_bytes: int) -> str:
    whole = (unit for unit, size in DECIMAL_BYTES.items() if size_bytes >= size and size_bytes % size == 0)
    unit = next(whole, "B")
    return f"{size_bytes // DECIMAL_BYTES[unit]}{unit}"


def clock_words(seconds: float) -> str:
    minutes, seconds_part = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds_part:02}" if hours else f"{minutes:02}:{seconds_part:02}"


def format_ratio(value: float | None) -> str:
    """Format a share to three digits, from 99 % on to two decimals; only exact values are `100 %` and `0 %`."""
    if value is None or not math.isfinite(value):
        return MISSING
    percent = 100.0 * value
    if 0.0 < percent < 0.01:
        return "< 0.01 %"
    if 99.99 < percent < 100.0:
        return "> 99.99 %"
    return (three_digits(percent) if percent < 99 else f"{percent:.2f}".rstrip("0").rstrip(".")) + " %"


def joined(names: Iterable[str], word: str = "and", comma: str = ", ") -> str:
    *first, last = names
    return f"{comma.join(first)} {word} {last}" if first else last


def utc_of(wall_ns: int) -> datetime | None:
    try:
        return datetime.fromtimestamp(wall_ns / 1e9, tz=timezone.utc)
    except (OverflowError, OSError, ValueError):
        return None


def utc_words(wall_ns: int) -> str:
    at = utc_of(wall_ns)
    return "" if at is None else f"{at:%Y-%m-%d %H:%M:%S} UTC"
