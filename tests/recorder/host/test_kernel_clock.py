"""The kernel's clock as it is read: against what the system itself prints, and on systems that do not tell."""

from __future__ import annotations

import ctypes
import json
import time
from pathlib import Path

from dds_trace.recorder.host import kernel_clock
from dds_trace.recorder.host.kernel_clock import read_adjtimex, read_boot_id, read_monotonic_pair


def test_the_correction_is_read_without_setting_anything():
    first, second = read_adjtimex(), read_adjtimex()
    assert first == second
    assert set(first) == {"frequency_ppb", "tick_us", "status"}
    assert abs(first["frequency_ppb"]) <= 500_000  # the kernel's own limit
    assert 9_000 <= first["tick_us"] <= 11_000
    json.dumps(first)


def test_a_correction_is_in_parts_per_billion(monkeypatch):
    def adjtimex(pointer):
        timex = pointer._obj  # what byref holds
        timex.freq, timex.tick, timex.status = -12 * 65536 - 32768, 9_999, 0x2001
        return 0

    monkeypatch.setattr(ctypes, "CDLL", lambda *_args, **_options: type("C", (), {"adjtimex": adjtimex}))
    assert read_adjtimex() == {"frequency_ppb": -12_500, "tick_us": 9_999, "status": 0x2001}


def test_a_system_that_forbids_the_call_gives_nothing(monkeypatch):
    forbidding = type("C", (), {"adjtimex": lambda _pointer: -1})
    monkeypatch.setattr(ctypes, "CDLL", lambda *_args, **_options: forbidding)
    assert read_adjtimex() is None
    monkeypatch.setattr(ctypes, "CDLL", lambda *_args, **_options: object())
    assert read_adjtimex() is None


def test_the_boot_id_is_the_kernels(monkeypatch):
    assert read_boot_id() == Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    monkeypatch.setattr(kernel_clock, "read_text", lambda _path: None)
    assert read_boot_id() is None


def test_both_clocks_are_read_at_one_instant(monkeypatch):
    # The second reading is the narrowest: 100 ns wide, raw 7000.
    monotonic = iter([0, 900, 1000, 1100, 2000, 2900, 3000, 3900, 4000, 4900])
    raw = iter([6000, 7000, 8000, 9000, 10_000])
    monkeypatch.setattr(time, "monotonic_ns", lambda: next(monotonic))
    monkeypatch.setattr(time, "clock_gettime_ns", lambda _clock: next(raw))
    assert read_monotonic_pair() == (1050, 7000)
