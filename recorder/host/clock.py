"""The clock of a device as the roles use it: injected, so that tests can make time themselves."""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import threading

STOP_CHECK_NS = 50_000_000
"""Longest part of a wait after which `stop` is looked at."""

_PR_SET_TIMERSLACK = 29  # linux/prctl.h


@dataclass(frozen=True, slots=True)
class ClockAnchor:
    """One instant on both clocks: `wall_ns` since 1970 and `monotonic_ns` of CLOCK_MONOTONIC."""

    wall_ns: int
    monotonic_ns: int

    @property
    def offset_ns(self) -> int:
        """The difference to add to a monotonic time for wall clock ns since 1970."""
        return self.wall_ns - self.monotonic_ns


class Clock(Protocol):
    """A clock and the waits on it."""

    def monotonic_ns(self) -> int:
        """Read CLOCK_MONOTONIC, in ns."""

    def anchor(self) -> ClockAnchor:
        """Read the monotonic and the wall clock at one instant."""

    def wait_until(self, monotonic_ns: int, stop: threading.Event) -> bool:
        """Sleep until `monotonic_ns`, or return at once if it has passed; return whether `stop` stayed unset."""


class SystemClock:
    """The real clock of this device."""

    monotonic_ns = staticmethod(time.monotonic_ns)

    def anchor(self) -> ClockAnchor:
        """Read both clocks some times and return the narrowest pair, so that one preemption does not spoil it."""
        best: tuple[int, ClockAnchor] | None = None
        for _ in range(20):
            before, wall, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
            if best is None or after - before < best[0]:
                best = after - before, ClockAnchor(wall, (before + after) // 2)
        assert best is not None
        return best[1]

    def wait_until(self, monotonic_ns: int, stop: threading.Event) -> bool:
        """Sleep without a final spin: a spin holds the interpreter lock, and T2 of the last message waits.

        A late send costs nothing in latency, since T1 is stamped when the message really goes.
        """
        while (left_ns := monotonic_ns - time.monotonic_ns()) > 0:
            if stop.is_set():
                return False
            # The last part in one sleep: each wake-up is a chance to be late.
            rest_ns = left_ns if left_ns < 2 * STOP_CHECK_NS else STOP_CHECK_NS
            time.sleep(rest_ns / 1e9)
        return not stop.is_set()


def sharpen_sleep() -> None:
    """Let the calling thread's sleeps end when they should: the kernel may add 50 us of slack by default."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
