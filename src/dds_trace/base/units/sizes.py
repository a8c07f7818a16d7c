"""Sizes: read as people write them (`33KB`, `4MB`, `1KiB`, plain bytes), written for people and for names of files."""

from __future__ import annotations

from ..errors import OptionError
from ..limits import shown
from .quantities import split_quantity

_DECIMAL_BYTES = {"GB": 10**9, "MB": 10**6, "KB": 10**3, "B": 1}
_BINARY_BYTES = {"GiB": 2**30, "MiB": 2**20, "KiB": 2**10}
UNIT_BYTES = {"": 1} | {unit.lower(): size for unit, size in (_DECIMAL_BYTES | _BINARY_BYTES).items()}
"""Unit in lower case -> its bytes; a number without unit is bytes."""


def parse_size(text: str, what: str = "size") -> int:
    """Read a size in bytes; KB is 1000, KiB 1024.

    Args:
        text: a number and one of the units B, KB, MB, GB, KiB, MiB and GiB, or a number alone.
        what: the name of the value in the error.

    Raises:
        OptionError: `text` is no size, or no whole number of bytes.
    """
    value, unit = split_quantity(text) or (0.0, "?")
    if unit not in UNIT_BYTES:
        raise OptionError(
            f"{what} {shown(text)} is not understood; write bytes, or 33KB, 4MB (1000), 1KiB, 2MiB (1024)"
        )
    size_bytes = value * UNIT_BYTES[unit]
    if size_bytes != int(size_bytes):
        raise OptionError(f"{what} {shown(text)} is not a whole number of bytes")
    return int(size_bytes)


def format_size(size_bytes: int) -> str:
    """Write a size exactly, with at most one decimal: `33 KB`, `1.5 MB`, `1 KiB`, `1405 B`."""
    for unit, factor in _DECIMAL_BYTES.items():
        if size_bytes >= factor > 1 and size_bytes % (factor / 10) == 0:
            return f"{size_bytes / factor:.15g} {unit}"
    for unit, factor in _BINARY_BYTES.items():
        if size_bytes >= factor and size_bytes % factor == 0:
            return f"{size_bytes // factor} {unit}"
    return f"{size_bytes} B"


def spell_size(size_bytes: int) -> str:
    """Write a size exactly and as `parse_size` reads it, in whole decimal units: `33KB`, `1500KB`, `91B`."""
    filled = (unit for unit, size in _DECIMAL_BYTES.items() if size_bytes >= size and size_bytes % size == 0)
    unit = next(filled, "B")
    return f"{size_bytes // _DECIMAL_BYTES[unit]}{unit}"
