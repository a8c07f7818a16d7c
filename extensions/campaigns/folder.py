"""The folder of a sweep."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from dds_trace.base.errors import OptionError, OutputError
from dds_trace.base.files import create_file, output_error, replacing, try_lock
from dds_trace.tracefile.format.ring import RING_SUFFIX

LOCK_PATIENCE_S = 30.0
"""Time for the recorders of a killed sweep to close their traces."""

POLL_S = 0.2

PARTS = ".parts"

TRACE_ENDINGS = ("", RING_SUFFIX)

LOG_ENDINGS = (".log", ".half.log")
"""After a segment's name: the logs of the relay and of its half of a bridge."""

_SEGMENT = r"\d{1,6}-\d{1,15}-\d{1,6}(\.\d{1,3}-\d{1,3})?\.mcap"
_CELL_TRACE = r"[\w+-][\w.+-]*\.ping\.mcap"
_OWN_NAME = re.compile(
    rf"({_SEGMENT}({'|'.join(map(re.escape, (*TRACE_ENDINGS, *LOG_ENDINGS)))})|{_CELL_TRACE}(\.ring|\.log)?)"
    r"(\.[0-9a-f]{8}\.part)?"
)


@contextlib.contextmanager
def locked_folder(folder: Path, note: Callable[[str], None]) -> Iterator[int]:
    """Make and lock the folder within the block; yield the lock, which programs of a killed sweep keep."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as err:
        raise OutputError(f"{folder}: {err.strerror}; give another --out") from err
    try:
        if not try_lock(lock, fcntl.LOCK_EX):
            note(f"{folder} is in use; waiting for the programs of an earlier sweep to end")
            deadline_s = time.monotonic() + LOCK_PATIENCE_S
            while not try_lock(lock, fcntl.LOCK_EX):
                if time.monotonic() > deadline_s:
                    raise OptionError(f"{folder} is in use by another sweep; wait for it or end it")
                time.sleep(POLL_S)
        yield lock
    finally:
        os.close(lock)


def make_parts(folder: Path) -> Path:
    parts = folder / PARTS
    try:
        parts.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise OutputError(f"{parts}: {err.strerror}; give another --out") from err
    if parts.is_symlink():
        raise OutputError(f"{parts} is a link; remove it, or give another --out")
    return parts


def clear_parts(parts: Path) -> list[str]:
    foreign = []
    for path in sorted(parts.iterdir()):
        if _OWN_NAME.fullmatch(path.name) and (path.is_symlink() or path.is_file()):
            path.unlink()
        else:
            foreign.append(path.name)
    return foreign


def remove_files(folder: Path, name: str, endings: Collection[str]) -> None:
    for ending in endings:
        path = folder / f"{name}{ending}"
        if path.is_symlink() or path.is_file():
            path.unlink(missing_ok=True)


def is_segment_name(name: str) -> bool:
    return re.fullmatch(_SEGMENT, name, re.ASCII) is not None


def segment_of(first: str, number: int, host: int) -> str:
    return first if number == 1 else f"{first.removesuffix('.mcap')}.{number}-{host}.mcap"


def place_of(segment: str) -> tuple[int, int]:
    number, _, host = segment.removesuffix(".mcap").partition(".")[2].partition("-")
    return int(number or 1), int(host or 0)


def log_path(folder: Path, segment: str) -> Path:
    return folder / f"{segment}.log"


def replace_text(path: Path, text: str) -> None:
    try:
        with replacing(path, fsync=True) as draft, create_file(draft) as file:
            file.write(text.encode())
    except OSError as err:
        raise output_error(path, err, "the state of the sweep") from err
