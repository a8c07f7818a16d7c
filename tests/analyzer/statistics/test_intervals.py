"""Intervals: ranks by hand and by exact sums, coverage by drawing, block lengths and the bootstrap against formulas."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dds_trace.analyzer.statistics.intervals import (
    bootstrap_mean,
    bootstrap_quantile,
    dependence_of,
    order_statistic_ranks,
    percentile_interval,
    quantile_of,
    ratio_interval,
)


def autoregressive(messages: int, correlation: float, seed: int):
    """Normal values whose neighbours correlate; the first 200 are thrown away."""
    noise = np.random.default_rng(seed).standard_normal(messages + 200)
    values = np.empty(messages + 200)
    values[0] = noise[0]
    for i in range(1, messages + 200):
        values[i] = correlation * values[i - 1] + math.sqrt(1 - correlation**2) * noise[i]
    return values[200:]


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


@given(values=st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=60), q=st.floats(0.01, 0.99))
@settings(deadline=None)
def test_quantiles_are_numpys(values, q):
    ordered = np.sort(np.array(values, np.int64))
    assert quantile_of(ordered, q) == pytest.approx(float(np.quantile(ordered, q)), rel=1e-12, abs=1e-3)


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


def test_independent_messages_count_in_full():
    found = [dependence_of(autoregressive(1000, 0.0, seed)) for seed in range(20)]
    assert sum(d.inflation < 1.3 for d in found) >= 17


def test_inflation_of_a_known_series():
    # An autoregressive series with correlation r of neighbours: (1 + r) / (1 - r), so 3 for 0.5 and 9 for 0.8.
    for correlation, inflation in ((0.5, 3.0), (0.8, 9.0)):
        found = [dependence_of(autoregressive(20_000, correlation, seed)) for seed in range(5)]
        assert np.mean([d.inflation for d in found]) == pytest.approx(inflation, rel=0.15)


def test_block_length_grows_as_politis_and_white_say():
    # b = (2 G^2 / D)^(1/3) n^(1/3), G = 2r / (1 - r)^2 sigma^2, D = 4/3 g(0)^2, g(0) = (1 + r) / (1 - r) sigma^2:
    # r = 0.5 gives G / g(0) = 4/3, b = (1.5 * 16/9)^(1/3) * 20000^(1/3) = 1.387 * 27.14 = 37.6.
    found = [dependence_of(autoregressive(20_000, 0.5, seed)).block_messages for seed in range(5)]
    assert np.mean(found) == pytest.approx(37.6, rel=0.25)


def test_constant_short_and_alternating_series_are_taken_as_independent():
    for series in (np.ones(500), np.arange(5), np.tile([0, 1], 200), np.empty(0)):
        assert dependence_of(series).block_messages == 1
        assert dependence_of(series).inflation == 1.0


def test_a_series_of_bursts_is_worth_fewer_messages():
    bursts = np.repeat(np.random.default_rng(3).random(200) < 0.1, 20)
    assert dependence_of(bursts).inflation > 8


def test_the_bootstrap_spreads_as_the_mean_does():
    values = autoregressive(400, 0.0, 1)
    assert bootstrap_mean(values).std() == pytest.approx(values.std() / 20, rel=0.1)
    alike = [autoregressive(2000, 0.8, seed) for seed in range(8)]
    spread = np.mean([bootstrap_mean(v, dependence_of(v).block_messages).std() for v in alike])
    assert spread == pytest.approx(3 / math.sqrt(2000), rel=0.2)  # inflation 9 of the variance


def test_the_bootstrap_spreads_as_a_quantile_does():
    drawn = [np.quantile(autoregressive(1000, 0.5, seed), 0.9) for seed in range(300)]
    found = []
    for seed in range(10):
        values = autoregressive(1000, 0.5, seed)
        block = dependence_of(values <= np.quantile(values, 0.9)).block_messages
        found.append(bootstrap_quantile(values, 0.9, block).std())
    assert np.mean(found) == pytest.approx(np.std(drawn), rel=0.15)


def test_bootstrap_draws_come_from_the_sample_and_are_the_same_each_time():
    values = np.random.default_rng(1).permutation(3000) * 10
    first = bootstrap_quantile(values, 0.99, 4)
    assert first.shape == (499,)
    assert set(first.tolist()) <= set(values.tolist())
    assert np.array_equal(first, bootstrap_quantile(values, 0.99, 4))
    assert not np.array_equal(first, bootstrap_quantile(values, 0.99, 4, seed=7))
    assert bootstrap_quantile(np.array([42]), 0.5).tolist() == [42.0] * 499


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
