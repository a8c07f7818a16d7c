"""A steady interpreter: no garbage collection and short switches while messages are measured."""

from __future__ import annotations

import gc
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

SWITCH_INTERVAL_S = 0.0005
"""Longest time that a computing thread keeps the interpreter lock from one that received a message (5 ms by default)."""


@contextmanager
def steady_interpreter() -> Iterator[None]:
    """Switch garbage collection off while the block runs, and let received messages wait less for other threads.

    Objects of a message are freed by reference counts; `collect_young` may be called in a quiet moment.
    """
    was_enabled, interval_s = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval_s)
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def collect_young() -> None:
    """Free the cycles made since the freeze: quick, as older objects are not looked at."""
    gc.collect()
