import ctypes
import json
import threading
import time
from pathlib import Path

import pytest
from namespaces import needs_namespaces
from processes import RunningCommand, ping

from dds_trace.analyzer.pipeline import analyze
from dds_trace.recorder.host import fingerprint
from dds_trace.recorder.host.clock import ClockAnchor, SystemClock, read_adjtimex, read_monotonic_pair, sharpen_sleep
from dds_trace.recorder.host.fingerprint import read_boot_id


def test_the_anchor_is_one_instant_on_both_clocks():
    anchor = SystemClock().anchor()
    wall, monotonic = time.time_ns(), time.monotonic_ns()
    # Both readings agree on how long ago the anchor was, but for what the clocks were adjusted meanwhile.
    assert abs((wall - anchor.wall_ns) - (monotonic - anchor.monotonic_ns)) < 1_000_000_000
    assert ClockAnchor(1_000, 400).offset_ns == 600


def test_a_wait_ends_at_its_time_and_not_before():
    clock = SystemClock()
    sharpen_sleep()
    until = clock.monotonic_ns() + 20_000_000
    assert clock.wait_until(until, threading.Event())
    assert clock.monotonic_ns() >= until


def test_a_time_that_has_passed_is_not_waited_for():
    assert SystemClock().wait_until(0, threading.Event())


def test_a_stop_ends_a_long_wait():
    clock, stop = SystemClock(), threading.Event()
    threading.Timer(0.05, stop.set).start()
    assert not clock.wait_until(clock.monotonic_ns() + 600_000_000_000, stop)


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


@pytest.mark.middleware
@needs_namespaces("unshare", "util-linux")
def test_a_relay_in_another_time_namespace_has_another_clock_and_none_was_set(tmp_path, domain_id):
    ahead = ("unshare", "-T", "--monotonic", "1000", "--boottime", "1000", "-f")
    sides = ("--backend", "socket")
    serving = ("--role", "relay", "--domain", domain_id, *sides, "--duration", "40", "--out", tmp_path / "relay.mcap")
    relay = RunningCommand("dds-record", *serving, prefix=ahead)
    relay.wait_for_line("serves domain")
    done = ping(domain_id, tmp_path / "ping.mcap", *sides, "--messages", 20, "--size", "1KB")
    assert (done.status, relay.finish().status) == (0, 0), done.stderr
    analysis = analyze(tmp_path)
    assert len({session.extra["boot_id"] for session in analysis.sessions}) == 2
    assert "clock_set" not in {found.code for found in analysis.findings}
    assert analysis.summary["received"].to_list() == [20]


def test_the_boot_id_is_the_kernels(monkeypatch):
    assert read_boot_id() == Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    monkeypatch.setattr(fingerprint, "read_text", lambda _path: None)
    assert read_boot_id() is None


def test_both_clocks_are_read_at_one_instant(monkeypatch):
    # The second reading is the narrowest: 100 ns wide, raw 7000.
    monotonic = iter([0, 900, 1000, 1100, 2000, 2900, 3000, 3900, 4000, 4900])
    raw = iter([6000, 7000, 8000, 9000, 10_000])
    monkeypatch.setattr(time, "monotonic_ns", lambda: next(monotonic))
    monkeypatch.setattr(time, "clock_gettime_ns", lambda _clock: next(raw))
    assert read_monotonic_pair() == (1050, 7000)
