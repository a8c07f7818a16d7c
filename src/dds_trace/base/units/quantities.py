"""A number with a unit behind it, taken apart and written: what sizes, durations and rates share."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

MISSING = "-"
"""Text in place of a number that does not exist; 0 would be a measurement."""

_QUANTITY = re.compile(r"\s*(\d{1,30}(?:\.\d{0,30})?|\.\d{1,30})\s*([a-zµ%]*)\s*", re.IGNORECASE | re.ASCII)


def split_quantity(text: str) -> tuple[float, str] | None:
    """Split `1.5 ms` into its number and its unit.

    Returns:
        The number, which has no sign and no exponent, and the unit in lower case (empty if there is none); None if
        `text` is not a number with a unit behind it.
    """
    match = _QUANTITY.fullmatch(text)
    return None if match is None else (float(match[1]), match[2].lower())


def format_quantity(value: float | None, units: Mapping[str, float]) -> str:
    """Write a value to three digits, in the unit that leaves one to three of them before the point: `1.25 ms`.

    Args:
        value: in the unit whose factor is 1; None, infinite and NaN are written as `MISSING`.
        units: unit -> its factor, from the largest to the smallest.
    """
    if value is None or not math.isfinite(value):
        return MISSING
    # 999.96 would be written as 1000: the larger unit takes it.
    unit = next((unit for unit, factor in units.items() if abs(value) >= 0.9995 * factor), [*units][-1])
    return f"{_three_digits(value / units[unit])} {unit}"


def _three_digits(value: float) -> str:
    """Three significant digits without exponent or trailing zeros behind the point; whole numbers stay whole."""
    if value == 0:
        return "0"
    decimals = max(0, 2 - math.floor(math.log10(abs(value)) + 1e-12))
    shown = f"{value:.{min(decimals, 9)}f}"
    return shown.rstrip("0").rstrip(".") if "." in shown else shown
