"""The clocks of a device, and how the kernel corrects them."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dds_trace.tracefile.format.json_fields import JsonObject

STOP_CHECK_NS = 50_000_000

_ANCHOR_READINGS, _PAIR_READINGS, _STEPS = 20, 5, 3
_PR_SET_TIMERSLACK = 29  # linux/prctl.h
_FREQUENCY_UNITS_PER_PPM = 1 << 16  # adjtimex(2): `freq` is in parts per million with 16 fractional bits


@dataclass(frozen=True, slots=True)
class ClockAnchor:
    """One instant on both clocks: `wall_ns` since 1970 and `monotonic_ns` of CLOCK_MONOTONIC."""

    wall_ns: int
    monotonic_ns: int

    @property
    def offset_ns(self) -> int:
        return self.wall_ns - self.monotonic_ns


class Clock(Protocol):
    """A clock and the waits on it; tests have their own."""

    def monotonic_ns(self) -> int: ...

    def anchor(self) -> ClockAnchor:
        """Read the monotonic and the wall clock at one instant."""

    def wait_until(self, monotonic_ns: int, stop: threading.Event) -> bool:
        """Sleep until `monotonic_ns`; return whether `stop` stayed unset."""


class SystemClock:
    monotonic_ns = staticmethod(time.monotonic_ns)

    def anchor(self) -> ClockAnchor:
        monotonic_ns, wall_ns = read_together(time.time_ns, _ANCHOR_READINGS)
        return ClockAnchor(wall_ns, monotonic_ns)

    def wait_until(self, monotonic_ns: int, stop: threading.Event) -> bool:
        """Sleep without a final spin, which would delay T2; a late send costs no latency."""
        while (left_ns := monotonic_ns - time.monotonic_ns()) > 0:
            if stop.is_set():
                return False
            # The last part in one sleep: each wake-up is a chance to be late.
            rest_ns = left_ns if left_ns < 2 * STOP_CHECK_NS else STOP_CHECK_NS
            time.sleep(rest_ns / 1e9)
        return not stop.is_set()


def sharpen_sleep() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def measured_step_ns() -> int:
    """Return the smallest of a few steps of CLOCK_MONOTONIC; clock_getres promises smaller ones."""
    steps_ns: list[int] = []
    last_ns = time.monotonic_ns()
    while len(steps_ns) < _STEPS:
        now_ns = time.monotonic_ns()
        if now_ns != last_ns:
            steps_ns.append(now_ns - last_ns)
        last_ns = now_ns
    return min(steps_ns)


def read_monotonic_pair() -> tuple[int, int]:
    """Return CLOCK_MONOTONIC and the unslewed CLOCK_MONOTONIC_RAW at one instant, ns."""
    return read_together(lambda: time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW))


def read_together(read_other: Callable[[], int], readings: int = _PAIR_READINGS) -> tuple[int, int]:
    """Return CLOCK_MONOTONIC and another clock at one instant, ns: the narrowest of some readings, as a preemption widens one."""
    narrowest: tuple[int, int, int] | None = None
    for _ in range(readings):
        before_ns, other_ns, after_ns = time.monotonic_ns(), read_other(), time.monotonic_ns()
        if narrowest is None or after_ns - before_ns < narrowest[0]:
            narrowest = after_ns - before_ns, (before_ns + after_ns) // 2, other_ns
    assert narrowest is not None
    return narrowest[1:]


class _Timex(ctypes.Structure):
    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("constant", ctypes.c_long),
        ("precision", ctypes.c_long),
        ("tolerance", ctypes.c_long),
        ("time", ctypes.c_long * 2),
        ("tick", ctypes.c_long),
        ("rest", ctypes.c_long * 32),
    )


def read_adjtimex() -> JsonObject | None:
    """Read how the kernel corrects CLOCK_MONOTONIC (`clock` of docs/trace-format.md); None where that is not permitted."""
    timex = _Timex(modes=0)  # no mode: nothing is set
    try:
        failed = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex)) < 0
    except AttributeError:  # a C library without the call
        return None
    if failed:
        return None
    return {
        "frequency_ppb": round(timex.freq * 1000 / _FREQUENCY_UNITS_PER_PPM),
        "tick_us": timex.tick,
        "status": timex.status,
    }
