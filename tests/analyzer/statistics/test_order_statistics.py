"""The ranks that enclose a quantile: by hand and by exact sums."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dds_trace.analyzer.statistics.percentiles import order_statistic_ranks


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
