"""The thread that hashes and stores a tap's messages, after everybody else has had the processor."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from dds_trace.base.threads import run_in_background

MOST_WAITING = 64
"""Messages that wait; when there are more, the receiving thread waits, and the middleware drops what its queue does not hold."""
NICENESS = 10


class Worker:
    """Calls `work` with what `hand_over` gets, in order."""

    def __init__(self, work: Callable[..., None]) -> None:
        self.error: BaseException | None = None
        self._work = work
        self._queue: queue.Queue[tuple[Any, ...] | None] = queue.Queue(MOST_WAITING)
        self.hand_over = self._queue.put
        self._thread = threading.Thread(target=self._run, name="tap-worker", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        run_in_background()
        with suppress(OSError):  # of this thread only
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while (item := self._queue.get()) is not None:
            if self.error is None:
                try:
                    self._work(*item)
                except BaseException as error:  # noqa: BLE001 - a thread has no caller
                    self.error = error

    def close(self) -> None:
        """Work at what was handed over, and end."""
        self._queue.put(None)
        self._thread.join()
