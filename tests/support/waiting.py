"""Wait for what happens elsewhere: in another process, thread or device."""

import time
from collections.abc import Callable, Iterable
from typing import TypeVar

T = TypeVar("T")


PATIENCE_S = 150.0
"""No test is about time; this only ends one that hangs."""


def wait_until(
    condition: Callable[[], T],
    timeout_s: float = PATIENCE_S,
    step_s: float = 0.02,
    meanwhile: Callable[[], object] = lambda: None,
) -> T:
    """Return what a condition says once that is true; fail if it never is."""
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < deadline, "did not happen in time"
        meanwhile()
        time.sleep(step_s)
    return found


def read_past(pipe: Iterable[str] | None, text: str) -> None:
    """Read up to a line with this text; a middleware prints too (Fast DDS, on stdout: another has a port of shared memory)."""
    said = []
    for line in pipe or ():
        said.append(line)
        if text in line:
            return
    raise AssertionError(f"ended before {text!r}: {said}")
