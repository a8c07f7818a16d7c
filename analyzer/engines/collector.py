"""Python's collector of garbage in the processes of a command that analyzes: seldom while it works, and not at its end."""

import atexit
import gc

_NEW_OBJECTS = 10_000
"""New objects behind which the collector looks for garbage. With Python's 700 it takes a twentieth of a worker's time, and of
4,000 traces half a second of the command's own process; nothing of size is left to it (`test_runs.py`)."""


def collect_seldom() -> None:
    """Let the collector look behind more new objects than Python has it, and not at all objects once more before the process ends.

    That last look takes 60 ms of a worker process, 0.1 s of a large analysis.
    """
    gc.set_threshold(_NEW_OBJECTS)
    atexit.register(gc.freeze)
