"""Trends: by hand, known rises, false alarms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drawn_series import autoregressive

from dds_trace.analyzer.run_statistics.modes import BLOCKS, Trend, block_medians, find_trend


def test_blocks_are_equally_long():
    assert block_medians(np.array([3, 1, 2, 9, 8, 7, 5]), 2).tolist() == [2, 8]
    assert block_medians(np.array([4, 1, 9, 2, 8, 7, 5, 5, 6]), 2).tolist() == [
        3,
        6,
    ]  # even: between the middle two


def test_a_straight_line_by_hand():
    # 128 messages in 32 blocks of four, medians 1.5, 5.5 ... plus 100: from 101.5 to 225.5.
    trend = find_trend(100 + np.arange(4 * BLOCKS))
    assert trend.change == pytest.approx(225.5 / 101.5 - 1)
    assert trend.p_value < 1e-4
    assert trend.is_sure(0.5)
    assert not trend.is_sure(1.5)
    fall = find_trend(300 - np.arange(4 * BLOCKS))
    assert fall.change == pytest.approx(174.5 / 298.5 - 1)
    assert fall.is_sure()


def test_short_and_constant_runs():
    assert find_trend(np.ones(4 * BLOCKS - 1)) is None
    constant = find_trend(np.full(1000, 7))
    assert (constant.change, constant.p_value, constant.is_sure()) == (0.0, 1.0, False)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("messages", [300, 1000])
def test_runs_without_a_trend_rarely_have_one(correlation, messages):
    runs = np.exp(0.5 * autoregressive(600, messages, correlation, seed=1))
    assert np.mean([find_trend(run).is_sure() for run in runs]) <= 0.01


def test_a_rise_is_found():
    rise = np.exp(np.linspace(0, 0.5, 1000))
    found = [find_trend(rise * np.exp(0.5 * run)) for run in autoregressive(200, 1000, 0.0, seed=2)]
    assert np.mean([trend.is_sure(0.1) for trend in found]) >= 0.9
    assert np.median([trend.change for trend in found]) == pytest.approx(np.exp(0.5) - 1, rel=0.1)


def test_a_burst_is_no_trend():
    values = np.exp(0.3 * np.random.default_rng(3).standard_normal(1000))
    values[900:960] *= 10
    assert not find_trend(values).is_sure()


def test_what_is_sure_begins_at_its_limits():
    assert Trend(-0.1, 0.001).is_sure(0.1)
    assert Trend(0.0, 0.0).is_sure()
    assert not Trend(0.1, 0.001).is_sure(0.101)
    assert not Trend(0.1, 0.00101).is_sure()


def test_a_single_rise_is_less_than_chance_makes():
    # Equal blocks but the last: 31 of 496 pairs rise, 30 after the step of two; variance 32 31 69 / 18 = 3802.7.
    values = np.ones(4 * BLOCKS)
    values[-4:] = 2
    trend = find_trend(values)
    assert trend.p_value == pytest.approx(math.erfc(30 / math.sqrt(2 * 3802 + 4 / 3)), rel=0.2)
    assert trend.change == 0.0


@pytest.mark.parametrize(("raised", "correlation"), [(8.2e-9, 0.0), (8.3e-9, 0.95)])
def test_what_is_below_a_billionth_of_the_level_is_no_correlation(raised, correlation):
    # A line from 1 to 32, at 16.5 in its middle, of which half a billionth is 8.25e-9. Sixteen neighbours of the 32 blocks
    # are raised: 29 pairs of neighbours are alike and two are not, 27 / 32 + (1 + 3 * 27 / 32) / 32 = 0.954, at most 0.95.
    medians = np.arange(1.0, BLOCKS + 1)
    medians[8:24] += raised
    # All 496 pairs rise; 495 after the step of two.
    variance = BLOCKS * (BLOCKS - 1) * (2 * BLOCKS + 5) / 18 * (1 + correlation) / (1 - correlation)
    expected = math.erfc(495 / math.sqrt(2 * variance))
    assert find_trend(np.repeat(medians, 4)).p_value == pytest.approx(expected, rel=1e-6)
