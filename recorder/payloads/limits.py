"""How much data a payload may hold: it lies in memory while it is sent, so that no disk has a part in the result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

if TYPE_CHECKING:
    from pathlib import Path

MAX_HELD_BYTES = 1 << 30
"""A small board has 2 GB."""


def check_held_bytes(held_bytes: int, path: Path) -> None:
    """Refuse data that does not fit into memory beside everything else.

    Raises:
        OptionError: it does not.
    """
    if held_bytes > MAX_HELD_BYTES:
        raise OptionError(
            f"{path} holds more than {MAX_HELD_BYTES >> 30} GiB of data to send; all of it is held in memory, "
            "so give a part of it"
        )
