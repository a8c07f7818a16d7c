"""Intervals: ranks by hand and by exact sums, coverage by drawing."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from series import autoregressive

from dds_trace.analyzer.statistics.intervals import (
    order_statistic_ranks,
    percentile_interval,
    ratio_interval,
)
from dds_trace.analyzer.statistics.percentiles import quantile_of


def exact_at_most(k: int, n: int, p: float) -> float:
    return sum(math.comb(n, j) * p**j * (1 - p) ** (n - j) for j in range(k + 1))


def test_ranks_for_the_median_of_ten_are_the_textbook_ones():
    # binomial(10, 1/2): P(B <= 1) = 11/1024 = 0.011, P(B <= 2) = 56/1024 = 0.055. So the 2nd and the 9th value.
    assert order_statistic_ranks(10, 0.5) == (2, 9)


def test_an_end_that_no_rank_gives_is_none():
    assert order_statistic_ranks(368, 0.99) == (360, 368)
    assert order_statistic_ranks(367, 0.99) == (359, None)
    assert order_statistic_ranks(3, 0.5) == (None, None)


@given(n=st.integers(1, 120), quantile=st.sampled_from([0.05, 0.5, 0.9, 0.95, 0.99]))
@settings(max_examples=80, deadline=None)
def test_ranks_are_the_tightest_that_exact_sums_allow(n, quantile):
    lower, upper = order_statistic_ranks(n, quantile)
    if lower is None:
        assert exact_at_most(0, n, quantile) > 0.025
    else:
        assert exact_at_most(lower - 1, n, quantile) <= 0.025 < exact_at_most(lower, n, quantile)
    if upper is None:
        assert quantile**n > 0.025
    else:
        assert 1 - exact_at_most(upper - 1, n, quantile) <= 0.025
        assert 1 - exact_at_most(upper - 2, n, quantile) > 0.025


def test_ranks_of_millions_follow_the_normal_approximation():
    n, q = 5_000_000, 0.999
    reach = 1.96 * math.sqrt(n * q * (1 - q))
    lower, upper = order_statistic_ranks(n, q)
    assert lower == pytest.approx(n * q - reach, abs=3)
    assert upper == pytest.approx(n * q + reach, abs=3)


def test_an_interval_by_hand():
    # 10 values 10..100 out of order but without a pattern; median 55 between the 5th and 6th, ends 2nd and 9th.
    values = np.array([50, 20, 90, 70, 10, 100, 30, 60, 40, 80], np.int64)
    interval = percentile_interval(values, 0.5)
    assert (interval.lower, interval.value, interval.upper) == (20.0, 55.0, 90.0)
    assert (interval.samples, interval.independent) == (10, 10)
    assert interval.is_two_sided


def test_a_percentile_the_sample_does_not_support_has_no_value():
    values = np.arange(99)
    assert percentile_interval(values, 0.99).value is None
    hundred = percentile_interval(np.random.default_rng(1).permutation(100), 0.99)
    assert hundred.value == pytest.approx(98.01)
    assert hundred.upper is None  # takes 368
    assert not hundred.is_two_sided
    assert percentile_interval(np.empty(0), 0.5).value is None


def test_lost_messages_are_infinitely_late():
    values = np.array([1.0, math.inf, 2.0, 3.0, math.inf, 4.0, 5.0, 6.0, 7.0, 8.0])
    interval = percentile_interval(values, 0.5)
    assert (interval.lower, interval.value, interval.upper) == (2.0, 5.5, math.inf)
    assert quantile_of(np.array([1.0, math.inf]), 0.5) == math.inf
    assert quantile_of(np.array([math.inf, math.inf]), 0.5) == math.inf


@given(values=st.lists(st.integers(0, 10**9), min_size=100, max_size=300))
@settings(deadline=None)
def test_percentiles_and_their_ends_are_monotonic(values):
    series = np.array(values)
    found = [percentile_interval(series, q) for q in (0.5, 0.9, 0.95, 0.99)]
    points = [i.value for i in found]
    assert points == sorted(points)
    for interval in found:
        if interval.lower is not None:
            assert interval.lower <= interval.value
        if interval.upper is not None:
            assert interval.value <= interval.upper


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
@pytest.mark.parametrize(("messages", "quantile"), [(1000, 0.5), (1000, 0.95), (2000, 0.99)])
def test_nineteen_of_twenty_intervals_hold_the_true_quantile(correlation, messages, quantile):
    true = NormalDist().inv_cdf(quantile)
    held = 0
    for seed in range(100):
        interval = percentile_interval(autoregressive(messages, correlation, seed), quantile)
        above = interval.lower is None or interval.lower <= true
        below = interval.upper is None or true <= interval.upper
        held += above and below
    assert held >= 88  # 95 expected, standard deviation 2.2


def test_intervals_that_ignore_correlation_would_fail_the_same_test():
    held = 0
    for seed in range(100):
        ordered = np.sort(autoregressive(1000, 0.8, seed))
        lower, upper = order_statistic_ranks(1000, 0.5)
        held += ordered[lower - 1] <= 0 <= ordered[upper - 1]
    assert held < 75


def test_ratio_by_hand():
    # Wilson for 0 of 100 at 95 %: upper end z^2 / (100 + z^2) = 3.8415 / 103.8415 = 0.03699.
    none = ratio_interval(np.zeros(100, np.bool_))
    assert (none.value, none.lower) == (0.0, 0.0)
    assert none.upper == pytest.approx(0.03699, abs=1e-5)
    whole = ratio_interval(np.ones(100, np.bool_))
    assert (whole.lower, whole.upper) == (pytest.approx(0.96301, abs=1e-5), 1.0)
    # 5 of 10, no pattern: centre 1/2, reach 1.96 sqrt(0.025 + 0.0096) / 1.384 = 0.2634.
    half = ratio_interval(np.array([1, 0, 0, 1, 1, 0, 1, 0, 1, 0], np.bool_))
    assert (half.lower, half.upper) == (pytest.approx(0.2366, abs=1e-4), pytest.approx(0.7634, abs=1e-4))
    assert ratio_interval(np.empty(0, np.bool_)).value is None


def test_losses_in_bursts_widen_the_ratio():
    single = np.zeros(4000, np.bool_)
    single[::10] = True
    bursts = np.repeat(np.random.default_rng(3).permutation(200) < 20, 20)
    assert single.mean() == bursts.mean() == 0.1
    width = {
        name: (i.upper or 0) - (i.lower or 0)
        for name, i in {
            "single": ratio_interval(np.random.default_rng(1).permutation(single)),
            "bursts": ratio_interval(bursts),
        }.items()
    }
    assert width["bursts"] > 2.5 * width["single"]
