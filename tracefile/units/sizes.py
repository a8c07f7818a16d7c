"""Sizes as people write them: `33KB`, `4MB`, `1KiB`, or plain bytes."""

from __future__ import annotations

import re

from .. import OptionError
from .counts import counted

UNIT_BYTES = {
    "": 1,
    "b": 1,
    "kb": 10**3,
    "mb": 10**6,
    "gb": 10**9,
    "kib": 2**10,
    "mib": 2**20,
    "gib": 2**30,
}
_SIZE = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([a-z]*)\s*", re.IGNORECASE)


def parse_size(text: str) -> int:
    """The number of bytes that `text` means; KB is 1000, KiB 1024.

    Raises:
        OptionError: it is no size.
    """
    match = _SIZE.fullmatch(text)
    unit = UNIT_BYTES.get(match[2].lower()) if match else None
    if match is None or unit is None:
        raise OptionError(
            f"size {text!r} is not understood; write bytes, or 33KB, 4MB (1000), 1KiB, 2MiB (1024)"
        )
    size_bytes = float(match[1]) * unit
    if size_bytes != int(size_bytes):
        raise OptionError(f"size {text!r} is not a whole number of bytes")
    return int(size_bytes)


def format_size(size_bytes: int) -> str:
    """The shortest way to write it exactly, in decimal units."""
    for unit in ("GB", "MB", "KB"):
        if size_bytes >= UNIT_BYTES[unit.lower()] and size_bytes % UNIT_BYTES[unit.lower()] == 0:
            return f"{size_bytes // UNIT_BYTES[unit.lower()]} {unit}"
    return counted(size_bytes, "byte")
