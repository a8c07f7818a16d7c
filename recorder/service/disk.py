"""The room that a recording leaves on its disk: other programs need some, and a system whose disk is full stands still."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from dds_trace.tracefile import OutputError
from dds_trace.tracefile.units.sizes import format_size

if TYPE_CHECKING:
    from pathlib import Path

    from ..options import KeepFree

_SHOWN_BYTES = 100_000
"""Sizes in messages are whole multiples."""


MOST_MORE_BYTES = 100_000_000
"""Free space beyond a fifth of what is to be kept is never waited for."""


def find_shortage(trace: Path, keep_free: KeepFree, *, was_short: bool = False) -> OutputError | None:
    """Return the error of a disk that has less free space than is to be kept; None if it has enough, or tells nothing.

    Args:
        trace: path of a trace; its folder, or the nearest one above that is there, lies on the disk.
        keep_free: what is to be kept.
        was_short: whether the disk was short of it: then a fifth more must be free, at most `MOST_MORE_BYTES`, so that
            recording does not stop and go on each second, as other programs write and delete.
    """
    try:
        disk = os.statvfs(next(each for each in trace.absolute().parents if each.is_dir()))
    except OSError:
        return None  # a folder that is gone: writing the trace says so
    free, floor = disk.f_bavail * disk.f_frsize, keep_free.floor_bytes(disk.f_blocks * disk.f_frsize)
    if free >= floor + (min(floor // 5, MOST_MORE_BYTES) if was_short else 0):
        return None
    return OutputError(
        f"{trace}: the disk has {_rounded(free)} free, and {_rounded(floor)} are to be kept (--keep-free); free space or "
        "record to another disk"
    )


def _rounded(size_bytes: int) -> str:
    return format_size(size_bytes // _SHOWN_BYTES * _SHOWN_BYTES if size_bytes > _SHOWN_BYTES else size_bytes)
