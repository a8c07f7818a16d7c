"""Files of a rotating recording, and free disk space."""

from __future__ import annotations

import os
import re
import stat
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from dds_trace.base.errors import OutputError
from dds_trace.base.units import format_size
from dds_trace.recorder.option import KeepFree
from dds_trace.tracefile.format.ring import RING_SUFFIX, ring_path
from dds_trace.tracefile.reading.mcap_source import read_first_session
from dds_trace.tracefile.writing.destination import TraceDestination

DIGITS = 5

MOST_MORE_BYTES = 100_000_000
"""Largest reserve above `-o keep_free` that must be free before writing resumes."""

_SHOWN_BYTES = 100_000

_NUMBERED = re.compile(rf"(?P<stem>.+)\.(?P<number>\d{{{DIGITS},}})\.mcap(?P<ring>{re.escape(RING_SUFFIX)})?")


class RotatedFiles:
    """The files `NAME.00001.mcap` ... of a recording; numbers follow the highest existing one."""

    def __init__(self, destination: TraceDestination, session_id: int) -> None:
        self._destination = destination
        self._session_id = session_id
        self._stem = destination.path.name.removesuffix(".mcap")

    def next(self) -> TraceDestination:
        folder = self._destination.path.parent
        number = max((int(match["number"]) for match in self._matches()), default=0) + 1
        return replace(self._destination, path=folder / f"{self._stem}.{number:0{DIGITS}d}.mcap", force=False)

    def drop_oldest(self, keep: int) -> list[Path]:
        """Return the files that it deleted: all but the newest `keep`, and those with a ring."""
        folder = self._destination.path.parent
        matches = sorted((m for m in self._matches() if not m["ring"]), key=lambda m: int(m["number"]))
        ours = [path for m in matches if _is_of_session(path := folder / m.string, self._session_id)]
        dropped = []
        for path in ours[: max(len(ours) - keep, 0)]:
            if not os.path.lexists(ring_path(path)):
                with suppress(OSError):  # the next rotation tries again
                    path.unlink()
                    dropped.append(path)
        return dropped

    def _matches(self) -> list[re.Match[str]]:
        with suppress(OSError):  # the folder is made with the first file
            names = [path.name for path in self._destination.path.parent.iterdir()]
            return [m for m in map(_NUMBERED.fullmatch, names) if m is not None and m["stem"] == self._stem]
        return []


def later_files(path: Path, session_id: int) -> list[Path]:
    matched = _NUMBERED.fullmatch(path.name)
    if matched is None:
        return []
    others = (_NUMBERED.fullmatch(other.name) for other in path.parent.glob("*.mcap"))
    numbers = {int(m["number"]): m.string for m in others if m is not None and m["stem"] == matched["stem"]}
    later = [path.parent / numbers[number] for number in sorted(numbers) if number > int(matched["number"])]
    return [file for file in later if _is_of_session(file, session_id)]


def _is_of_session(path: Path, session_id: int) -> bool:
    with suppress(OSError):
        if stat.S_ISREG(path.lstat().st_mode):
            session = read_first_session(path)
            return session is not None and session.session_id == session_id
    return False


def find_shortage(trace: Path, keep_free: KeepFree, *, was_short: bool = False) -> OutputError | None:
    """Return the error of a disk with too little free space, None if it has enough.

    A disk that was short needs a fifth more, at most `MOST_MORE_BYTES`, so that recording does not alternate every
    second.
    """
    try:
        disk = os.statvfs(next(folder for folder in trace.absolute().parents if folder.is_dir()))
    except OSError:
        return None  # a folder that is gone: writing the trace fails
    free, floor = disk.f_bavail * disk.f_frsize, keep_free.floor_bytes(disk.f_blocks * disk.f_frsize)
    if free >= floor + (min(floor // 5, MOST_MORE_BYTES) if was_short else 0):
        return None
    return OutputError(
        f"{trace}: the disk has {_rounded(free)} free, and {_rounded(floor)} must stay free (-o keep_free); delete files or "
        "record to another disk"
    )


def _rounded(size_bytes: int) -> str:
    return format_size(size_bytes // _SHOWN_BYTES * _SHOWN_BYTES if size_bytes > _SHOWN_BYTES else size_bytes)
