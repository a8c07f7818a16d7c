"""The scheduling of threads whose work must not delay a time stamp."""

from __future__ import annotations

import os
from contextlib import suppress


def run_in_background() -> None:
    """Puts the calling thread back under the ordinary scheduler.

    A thread inherits SCHED_FIFO from the one that starts it (`dds-record --realtime`). Never raises: without the
    right to change it, there was no real-time priority to inherit; nor is there one outside of Linux.
    """
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
