"""Values that are dear to make: made by the first worker of a test run that asks for one, read from a file by the others."""

import fcntl
import os
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

VARIABLE = "DDS_TRACE_TESTS_KEPT"
"""Names the folder of this test run; the session makes it and takes it away. Without one nothing is kept."""


def kept(make: Callable[[], T], name: str = "") -> Callable[[], T]:
    """Return a function that gives the one value of `make`, known by a name or as the function; it is not to be changed."""

    @cache
    def value() -> T:
        if VARIABLE not in os.environ:
            return make()
        path = Path(os.environ[VARIABLE], name or f"{make.__module__}-{make.__qualname__}")
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                made = make()
                draft = path.with_suffix(".draft")
                draft.write_bytes(pickle.dumps(made))
                draft.rename(path)
                return made
        return pickle.loads(path.read_bytes())

    return value
