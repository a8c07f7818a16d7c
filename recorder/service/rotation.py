"""The files of one rotating recording: which comes next, and which of the oldest may go."""

from __future__ import annotations

import os
import re
import stat
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from dds_trace.base.errors import OutputError
from dds_trace.base.units import format_size
from dds_trace.tracefile.format.ring import RING_SUFFIX, ring_path
from dds_trace.tracefile.reading.first_session import read_first_session

if TYPE_CHECKING:
    from pathlib import Path

    from dds_trace.tracefile.writing.destination import TraceDestination

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


DIGITS = 5
"""Digits of a file's number, so that names sort as the files were written; a hundred thousandth file has one more."""

_NUMBERED = re.compile(rf"(?P<stem>.+)\.(?P<number>\d{{{DIGITS},}})\.mcap(?P<ring>{re.escape(RING_SUFFIX)})?")
"""Name of a file, or of its ring."""


def later_files(path: Path, session_id: int) -> list[Path]:
    """Return the files of a recording that it wrote behind `path`, in their order; none if `path` is not of a rotating one."""
    matched = _NUMBERED.fullmatch(path.name)
    if matched is None:
        return []
    others = (_NUMBERED.fullmatch(other.name) for other in path.parent.glob("*.mcap"))
    numbers = {int(m["number"]): m.string for m in others if m is not None and m["stem"] == matched["stem"]}
    later = [path.parent / numbers[each] for each in sorted(numbers) if each > int(matched["number"])]
    return [file for file in later if _is_of(file, session_id)]


def _is_of(path: Path, session_id: int) -> bool:
    """Return whether a regular file begins with this session."""
    with suppress(OSError):
        if stat.S_ISREG(path.lstat().st_mode):
            session = read_first_session(path)
            return session is not None and session.session_id == session_id
    return False


class RotatedFiles:
    """The files `NAME.00001.mcap`, `NAME.00002.mcap` ... of one recording, whose `--out` is `NAME.mcap`.

    Numbers go on behind the highest one that is there, whoever wrote it: no file is ever written over.

    Args:
        destination: the one that was asked for.
        session_id: the recording.
    """

    def __init__(self, destination: TraceDestination, session_id: int) -> None:
        self._destination = destination
        self._session_id = session_id
        self._stem = destination.path.name.removesuffix(".mcap")

    def next(self) -> TraceDestination:
        """Return the destination of the next file; its number is above all that are taken."""
        folder = self._destination.path.parent
        taken = [int(match["number"]) for match in self._matches()]
        number = max(taken, default=0) + 1
        return replace(self._destination, path=folder / f"{self._stem}.{number:0{DIGITS}d}.mcap", force=False)

    def drop_oldest(self, keep: int) -> list[Path]:
        """Delete the oldest files of this recording beyond `keep`, the one that is written now included.

        A file is deleted only if its name is one of ours, it is a regular file without a ring beside it, and the session
        in it is this one: never a file of another recording, nor one whose events are not all in it.

        Returns:
            The paths that were deleted.
        """
        folder = self._destination.path.parent
        matches = sorted((m for m in self._matches() if not m["ring"]), key=lambda m: int(m["number"]))
        ours = [
            path for path in (folder / match.string for match in matches) if _is_of(path, self._session_id)
        ]
        dropped = []
        for path in ours[: max(len(ours) - keep, 0)]:
            if not os.path.lexists(ring_path(path)):
                with suppress(OSError):  # the next file tries again
                    path.unlink()
                    dropped.append(path)
        return dropped

    def _matches(self) -> list[re.Match[str]]:
        with suppress(OSError):  # the folder comes with the first file
            names = [path.name for path in self._destination.path.parent.iterdir()]
            return [m for m in map(_NUMBERED.fullmatch, names) if m is not None and m["stem"] == self._stem]
        return []
