"""The device's clock: its anchor and its waiting."""

from __future__ import annotations

import threading
import time

from dds_trace.recorder.host.clock import ClockAnchor, SystemClock, sharpen_sleep


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
