"""The ways in which a process is told to end: a signal sets an event, and the kernel ends a child whose parent is gone."""

from __future__ import annotations

import os
import shutil
import signal
import threading
from queue import SimpleQueue

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_UNLESS_ORPHAN = 'test "$PPID" = "$0" && exec "$@"'


def stop_at_signals() -> threading.Event:
    """Return an event that SIGINT and SIGTERM set from now on, however often and whenever they come.

    Python runs a handler between any two steps of the main thread, also while that holds the event's lock inside
    `wait()` or inside a handler before: one that called `set()` would wait for that lock for ever. `SimpleQueue.put` may
    be entered anew; what it hands over is taken by a thread of its own, which sets the event.
    """
    stop = threading.Event()
    came: SimpleQueue[int] = SimpleQueue()

    def set_behind_first() -> None:
        came.get()
        stop.set()

    threading.Thread(target=set_behind_first, name="stop-signals", daemon=True).start()
    for number in STOP_SIGNALS:
        signal.signal(number, lambda received, _: came.put(received))
    return stop


def dying_with_us() -> list[str]:
    """Return the words before a command that let the kernel end it by SIGTERM when this process ends, however it does.

    Empty where the system has no `setpriv` (util-linux, on every Debian and its relatives). The kernel sends nothing for
    a parent that was gone before `setpriv` asked: a shell, which the command replaces, compares its parent with us.
    """
    setpriv = shutil.which("setpriv")
    if setpriv is None:
        return []
    return [setpriv, "--pdeathsig", "TERM", "--", "sh", "-c", _UNLESS_ORPHAN, str(os.getpid())]
