"""The files of one rotating recording: which comes next, and which of the oldest may go."""

from __future__ import annotations

import os
import re
import stat
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from dds_trace.tracefile.format.ring import RING_SUFFIX, ring_path
from dds_trace.tracefile.reading.first_session import read_first_session

if TYPE_CHECKING:
    from pathlib import Path

    from dds_trace.tracefile import TraceDestination

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
