"""Percentiles with their sample support, moments and histograms, by hand and against plain loops."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.statistics.percentiles import PERCENTILES, histogram_of, summarize_values

NANOSECONDS = st.integers(-(10**6), 10**15)


def summarize(values):
    return summarize_values(np.sort(np.array(values, np.int64)))


def test_ten_values_by_hand():
    found = summarize([50, 10, 30, 20, 40, 60, 100, 80, 90, 70])
    assert found == {
        "mean": 55.0,
        "std": pytest.approx(math.sqrt(8250 / 9)),
        "min": 10.0,
        "p50": 55.0,  # between the 5th and the 6th: 50 + 0.5 * 10
        "p90": pytest.approx(91.0),  # position 0.9 * 9 = 8.1: 90 + 0.1 * 10
        "p95": None,
        "p99": None,
        "p99_9": None,
        "max": 100.0,
    }


def test_nothing_and_one():
    assert set(summarize([]).values()) == {None}
    one = summarize([7])
    assert (one["mean"], one["min"], one["p50"], one["max"]) == (7.0, 7.0, 7.0, 7.0)
    assert (one["std"], one["p90"]) == (None, None)


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


def test_histogram_by_hand():
    # Below 2048 ns every value has its own bucket; 4096..4099 share one of width 4.
    histogram = histogram_of(np.array([-3, 0, 1, 5, 5, 2047, 4096, 4099, 4100]))
    assert histogram.value_ns.tolist() == [-3.0, 0.0, 1.0, 5.0, 2047.0, 4097.5, 4101.5]
    assert histogram.count.tolist() == [1, 1, 1, 2, 1, 2, 1]


def test_histogram_of_nothing():
    assert len(histogram_of(np.empty(0, np.int64)).value_ns) == 0


@given(st.lists(st.integers(-(2**62), 2**62), max_size=200))
def test_histogram_keeps_every_value_within_a_tenth_of_a_percent(values):
    histogram = histogram_of(np.sort(np.array(values, np.int64)))
    assert histogram.count.sum() == len(values)
    assert histogram.value_ns.tolist() == sorted(set(histogram.value_ns.tolist()))
    centres = np.repeat(histogram.value_ns, histogram.count.astype(int))
    for value, centre in zip(sorted(values), centres.tolist(), strict=True):
        assert abs(value - centre) <= 0.0005 * abs(value) + 1e-9
