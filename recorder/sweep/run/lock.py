"""The lock of a sweep's folder: one sweep at a time, the programs of a killed one included."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError, OutputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

LOCK_PATIENCE_S = 30.0
"""Time for the recorders of a killed sweep to close their traces."""

POLL_S = 0.2


@contextlib.contextmanager
def holding_folder(folder: Path, waiting: Callable[[str], None]) -> Iterator[int]:
    """Keep a second sweep out of the folder while the block runs.

    The programs of a sweep hold the lock as well: a killed sweep is not resumed before the last of its programs has
    closed its trace.

    Args:
        folder: folder of the sweep, made if it is missing.
        waiting: called once with a line of text if the lock is not free at once.

    Yields:
        File descriptor of the lock, for the programs to inherit.

    Raises:
        OutputError: the folder cannot be made.
        OptionError: another sweep is at work in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as err:
        raise OutputError(f"{folder}: {err.strerror}; give another --out") from err
    try:
        _take_lock(lock, folder, waiting)
        yield lock
    finally:
        os.close(lock)


def _take_lock(lock: int, folder: Path, waiting: Callable[[str], None]) -> None:
    if _try_lock(lock):
        return
    waiting(f"{folder} is in use; waiting for the programs of an earlier sweep to end")
    deadline_s = time.monotonic() + LOCK_PATIENCE_S
    while not _try_lock(lock):
        if time.monotonic() > deadline_s:
            raise OptionError(f"{folder}: another sweep is at work here; wait for it or end it")
        time.sleep(POLL_S)


def _try_lock(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
