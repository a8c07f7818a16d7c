"""Slews from drawn fits: which steps are one slew, which are jumps, and how fast it was."""

from __future__ import annotations

import numpy as np
import pytest

from dds_trace.analyzer.clocks.slews import Stretch, find_slews

MS = 1_000_000
S = 1_000_000_000
STEADY, FAST, UNSURE = (0.0, 1000.0), (400_000.0, 50_000.0), (0.0, 500_000.0)


def stretches(*drawn):
    """Stretches from (start and end in s, drift and its bound, step and its bound in ms)."""
    return [
        Stretch(begin * S, end * S, *drift, round(step * MS), round(bound * MS))
        for begin, end, drift, step, bound in drawn
    ]


def found(drawn, gain_ppm=0, begin_s=0, end_s=100):
    """Slews with a knot every second, each known within 10 us, of a clock that gains from a begin to an end."""
    at_ns = np.arange(0, 100 * S + 1, S)
    offset_ns = (np.clip(at_ns, begin_s * S, end_s * S) - begin_s * S) * gain_ppm // 1_000_000
    return list(find_slews(stretches(*drawn), at_ns, offset_ns, np.full(len(at_ns), 10_000)))


def test_three_steps_within_windows_are_a_slew_with_its_rate():
    drawn = [(0, 20, STEADY, 0, 0)] + [(20 + 5 * n, 25 + 5 * n, UNSURE, 10, 0.1) for n in range(8)]
    (slew,) = found([*drawn, (60, 100, STEADY, 10, 0.1)], gain_ppm=2000, begin_s=20, end_s=60)
    assert (slew.first, slew.after) == (1, 10)
    assert slew.rate_ppm == pytest.approx(2000, rel=0.05)
    # 42 of its seconds held the 40 of the slew, which is nearly as fast.
    assert (slew.end_ns - slew.start_ns) / S == pytest.approx(40, abs=2)
    assert slew.bound_ppm < 1


def test_a_step_that_barely_shows_beside_a_fast_clock_is_a_slew():
    drawn = [(0, 40, FAST, 0, 0), (40, 100, STEADY, 12, 11)]
    (slew,) = found(drawn, gain_ppm=600, begin_s=20, end_s=60)
    assert (slew.first, slew.after) == (1, 2)
    assert slew.rate_ppm == pytest.approx(600, rel=0.05)


@pytest.mark.parametrize(
    "drawn",
    [
        [(0, 40, STEADY, 0, 0), (40, 100, STEADY, 12, 11)],  # barely, and nothing ran fast
        [(0, 40, FAST, 0, 0), (40, 100, FAST, 500, 5)],  # a clock that was set while it drifted
        [(0, 40, (-400_000.0, 50_000.0), 0, 0), (40, 100, STEADY, 12, 11)],  # the other way
        [(0, 40, FAST, 0, 0)],  # no step at all
        [(0, 30, STEADY, 0, 0), (30, 60, STEADY, 12, 11), (60, 90, STEADY, 12, 11), (90, 99, STEADY, 12, 11)],
        [(0, 30, STEADY, 0, 0), (30, 35, STEADY, 12, 1), (35, 40, STEADY, -12, 1), (40, 99, STEADY, 12, 1)],
    ],
    ids=["alone", "set", "other way", "drift", "surely slow between", "to and fro"],
)
def test_jumps_and_drifts_are_no_slews(drawn):
    assert found(drawn, gain_ppm=600, begin_s=20, end_s=60) == []


def test_two_slews_are_told_apart():
    up = [(20 + 5 * n, 25 + 5 * n, UNSURE, 10, 0.1) for n in range(3)]
    down = [(60 + 5 * n, 65 + 5 * n, UNSURE, -10, 0.1) for n in range(3)]
    slews = found([(0, 20, STEADY, 0, 0), *up, *down], gain_ppm=2000, begin_s=20, end_s=35)
    assert [(slew.first, slew.after) for slew in slews] == [(1, 4), (4, 7)]


def test_many_knots_are_thinned():
    at_ns = np.arange(0, 100 * S, S // 100)
    offset_ns = at_ns * 1000 // 1_000_000
    drawn = stretches((0, 20, STEADY, 0, 0), *((20 + n, 21 + n, UNSURE, 1, 0.1) for n in range(80)))
    (slew,) = find_slews(drawn, at_ns, offset_ns, np.full(len(at_ns), 10_000))
    assert slew.rate_ppm == pytest.approx(1000, rel=1e-3)
