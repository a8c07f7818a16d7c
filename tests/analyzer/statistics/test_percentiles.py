"""Percentiles: by hand, against numpy, and the sample sizes that the literature gives."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dds_trace.analyzer.statistics.percentiles import (
    PERCENTILES,
    STATISTICS,
    minimum_messages,
    order_statistic_ranks,
    planned_messages,
    quantile_of,
    summarize_values,
)

NANOSECONDS = st.integers(-(10**6), 10**15)


def summarize(values):
    return summarize_values(np.sort(np.array(values, np.int64)))


def test_ten_values_by_hand():
    found = summarize([50, 10, 30, 20, 40, 60, 100, 80, 90, 70])
    rarer = {percentile.name for percentile in PERCENTILES if percentile.needs > 10}
    assert {found.pop(name) for name in rarer} == {None}
    assert found == {
        "mean": 55.0,
        "std": pytest.approx(math.sqrt(8250 / 9)),
        "min": 10.0,
        "p50": 55.0,  # between the 5th and the 6th: 50 + 0.5 * 10
        "p90": pytest.approx(91.0),  # position 0.9 * 9 = 8.1: 90 + 0.1 * 10
        "max": 100.0,
    }


def test_nothing_and_one():
    assert set(summarize([]).values()) == {None}
    one = summarize([7])
    assert (one["mean"], one["min"], one["p50"], one["max"]) == (7.0, 7.0, 7.0, 7.0)
    assert (one["std"], one["p90"]) == (None, None)


def test_labels_and_the_series_of_decades():
    assert [row.label for row in STATISTICS if row.name in ("p50", "p99_9")] == ["median", "p99.9"]
    labels = {percentile.label: percentile.is_decade for percentile in PERCENTILES}
    assert labels.items() >= {"p50": True, "p90": True, "p95": False, "p99": True, "p99.9": True}.items()


@pytest.mark.parametrize(("name", "needs"), [("p90", 10), ("p95", 20), ("p99", 100), ("p99_9", 1000)])
def test_a_percentile_takes_its_number_of_samples(name, needs):
    assert summarize(range(needs - 1))[name] is None
    quantile = next(p.quantile for p in PERCENTILES if p.name == name)
    assert summarize(range(needs))[name] == pytest.approx(quantile * (needs - 1))


@given(st.lists(NANOSECONDS, min_size=1, max_size=300))
def test_percentiles_are_numpys_linear_and_monotonic(values):
    found = summarize(values)
    given_ones = [(p, found[p.name]) for p in PERCENTILES if found[p.name] is not None]
    for percentile, value in given_ones:
        assert value == pytest.approx(np.quantile(values, percentile.quantile, method="linear"), rel=1e-12)
    heights = [found["min"], *(value for _, value in given_ones), found["max"]]
    assert heights == sorted(heights)


@given(values=st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=60), q=st.floats(0.01, 0.99))
def test_quantiles_are_numpys(values, q):
    ordered = np.sort(np.array(values, np.int64))
    assert quantile_of(ordered, q) == pytest.approx(float(np.quantile(ordered, q)), rel=1e-12, abs=1e-3)


def test_known_figures():
    assert planned_messages(0.99) == 368
    assert planned_messages(0.999) == 3688
    assert planned_messages(0.5) == 6  # 0.5**6 = 0.016
    assert planned_messages(0.01) == 368  # the low tail likewise
    assert planned_messages(0.99, confidence=0.99) == 528  # log(0.005) / log(0.99) = 527.2


def test_alike_neighbours_take_more_messages():
    assert planned_messages(0.99, inflation=3.0) == 1102  # 3 x 367.03
    assert planned_messages(0.99, inflation=0.2) == 368  # never fewer than independent ones


@pytest.mark.parametrize("quantile", [0.5, 0.9, 0.95, 0.99, 0.999])
def test_planned_is_the_first_size_with_both_ends(quantile):
    planned = planned_messages(quantile)
    assert None not in order_statistic_ranks(planned, quantile)
    assert None in order_statistic_ranks(planned - 1, quantile)


def test_minimum_agrees_with_the_summary():
    assert {p.name: minimum_messages(p.quantile) for p in PERCENTILES} == {p.name: p.needs for p in PERCENTILES}
    assert minimum_messages(0.9999) == 10_000


@pytest.mark.parametrize("bad", [0.0, 1.0, -1.0, 1.5, 95.0])
def test_quantiles_and_confidences_are_no_percents(bad):
    for quantile, confidence in ((bad, 0.95), (0.99, bad)):
        with pytest.raises(ValueError, match="between 0 and 1"):
            planned_messages(quantile, confidence)


def test_an_error_of_arithmetic_takes_no_further_message():
    # 0.5**5 = (1 - 0.9375) / 2: five messages, each of which 200,000 count as.
    assert planned_messages(0.5, 0.9375) == 5
    assert planned_messages(0.5, 0.9375, math.nextafter(200_000, math.inf)) == 1_000_000
    assert planned_messages(0.5, 0.9375, 200_000 + 1e-9) == 1_000_001


def test_two_values_have_a_deviation():
    assert summarize([10, 20])["std"] == math.sqrt(50)


def test_a_quantile_that_is_one_of_the_values_is_not_spoiled_by_a_lost_neighbour():
    assert quantile_of(np.array([1.0, 2.0, np.inf]), 0.5) == 2.0
    assert quantile_of(np.array([1.0, 2.0, np.inf]), 0.75) == np.inf


def exact_at_most(k, n, p):
    return sum(math.comb(n, j) * p**j * (1 - p) ** (n - j) for j in range(k + 1))


def test_ranks_for_the_median_of_ten_are_the_textbook_ones():
    # binomial(10, 1/2): P(B <= 1) = 11/1024 = 0.011, P(B <= 2) = 56/1024 = 0.055. So the 2nd and the 9th value.
    assert order_statistic_ranks(10, 0.5) == (2, 9)


def test_an_end_that_no_rank_gives_is_none():
    assert order_statistic_ranks(368, 0.99) == (360, 368)
    assert order_statistic_ranks(367, 0.99) == (359, None)
    assert order_statistic_ranks(3, 0.5) == (None, None)


@given(n=st.integers(1, 120), quantile=st.sampled_from([0.05, 0.5, 0.9, 0.95, 0.99]))
@settings(max_examples=80)
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
