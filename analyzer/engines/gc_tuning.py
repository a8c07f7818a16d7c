"""GC tuning of analysis processes, applied before any heavy import."""

import atexit
import gc

NEW_OBJECTS = 10_000
"""Allocations between two collections: Python's 700 cost 5 % of a worker's time; `test_runs.py` checks that little is left.
"""


def tune_gc() -> None:
    """Collect less often, and skip the last collection at exit, 0.1 s of a large analysis."""
    gc.set_threshold(NEW_OBJECTS)
    atexit.register(gc.freeze)
