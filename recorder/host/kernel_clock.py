"""The kernel's correction of this device's clock, and the boot that the clock counts from; both are only read."""

from __future__ import annotations

import ctypes
import time
from typing import TYPE_CHECKING

from .fingerprint import read_text

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import JsonObject

_FREQUENCY_UNITS_PER_PPM = 1 << 16  # adjtimex(2): `freq` is in parts per million with 16 fractional bits

_PAIRS = 5
"""Readings of two clocks of which the narrowest counts, so that one preemption does not spoil it."""


class _Timex(ctypes.Structure):
    """`struct timex` of adjtimex(2), as far as it is read here; the rest is room for what the kernel writes."""

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
    """Read how the kernel corrects CLOCK_MONOTONIC, without privileges; None where that is not permitted.

    Returns:
        `frequency_ppb`: correction that NTP or PTP holds (adjtimex's `freq`); `tick_us`: length of a tick, 10,000
        where nothing slews by it (chrony does for large corrections); `status`: bits of `STA_*`, of which 0x40 says
        that the clock is not synchronized.
    """
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


def read_boot_id() -> str | None:
    """Return the random text that the kernel drew at boot: sessions with one text share CLOCK_MONOTONIC."""
    return read_text("/proc/sys/kernel/random/boot_id") or None


def read_monotonic_pair() -> tuple[int, int]:
    """Return CLOCK_MONOTONIC and CLOCK_MONOTONIC_RAW at one instant, ns; only the first one is slewed by NTP."""
    best: tuple[int, int, int] | None = None
    for _ in range(_PAIRS):
        before_ns = time.monotonic_ns()
        raw_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        after_ns = time.monotonic_ns()
        if best is None or after_ns - before_ns < best[0]:
            best = after_ns - before_ns, (before_ns + after_ns) // 2, raw_ns
    assert best is not None
    return best[1:]
