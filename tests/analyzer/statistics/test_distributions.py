import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import pdtr, pdtrc

from dds_trace.analyzer.statistics.distributions import poisson_limits, shift_for_power, student_cdf, student_quantile
from dds_trace.analyzer.statistics.intervals import Basis, Interval, messages_to_end, ranges_overlap, without_open_end
from dds_trace.analyzer.statistics.percentiles import RELATIVE_ERROR, histogram_of


@pytest.mark.parametrize(
    ("probability", "degrees", "quantile"),
    [  # scipy.stats.t.ppf of scipy 1.17.1
        (0.975, 0.7, 36.611415031588656),
        (0.975, 3, 3.1824463052837078),
        (0.975, 7.3, 2.345066736547703),
        (0.995, 9, 3.249835541592126),
        (0.9, 30, 1.3104150253913955),
        (0.975, 5000, 1.9604385517065073),
    ],
)
def test_quantiles_are_those_of_a_library(probability, degrees, quantile):
    assert student_quantile(probability, degrees) == pytest.approx(quantile, rel=1e-9)


@given(t=st.floats(-50, 50), degrees=st.floats(0.5, 500))
def test_the_distribution_is_symmetric_and_its_quantile_leads_back(t, degrees):
    probability = student_cdf(t, degrees)
    assert probability + student_cdf(-t, degrees) == pytest.approx(1.0, abs=1e-12)
    if 1e-6 < probability < 1 - 1e-6:
        assert student_quantile(probability, degrees) == pytest.approx(t, abs=1e-6 * max(1, abs(t)))


def test_infinite_degrees_are_the_normal_distribution():
    assert student_cdf(1.959963984540054, math.inf) == pytest.approx(0.975, abs=1e-12)
    assert student_quantile(0.975, math.inf) == pytest.approx(1.959963984540054, rel=1e-12)
    assert student_cdf(math.inf, 3) == 1.0
    assert student_cdf(-math.inf, 3) == 0.0


@pytest.mark.parametrize(
    ("degrees", "shift"),
    [  # the root of scipy.stats.nct.sf(t, degrees, shift) = 0.8
        (2, 5.65348926640557),
        (4, 3.7610602610043022),
        (8, 3.2009222385156204),
        (98, 2.8294146753960376),
    ],
)
def test_shifts_are_those_of_the_noncentral_t(degrees, shift):
    assert shift_for_power(degrees) == pytest.approx(shift, abs=1e-8)


def test_shifts_with_many_degrees_are_sums_of_two_normal_quantiles():
    assert shift_for_power(1e6) == pytest.approx(1.959964 + 0.841621, abs=1e-4)
    assert shift_for_power(1e6, 0.5, 0.5) == pytest.approx(0.674490, abs=1e-4)  # below one


def test_a_true_difference_of_that_shift_is_found_in_80_of_100():
    samples = np.random.default_rng(1).standard_normal((20_000, 5)) + shift_for_power(4) / math.sqrt(5)
    t = samples.mean(axis=1) / samples.std(axis=1, ddof=1) * math.sqrt(5)
    assert (t > student_quantile(0.975, 4)).mean() == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize(
    ("count", "low", "high"),
    [  # F. Garwood 1936, table I
        (0, 0.0, 3.689),
        (1, 0.0253, 5.572),
        (5, 1.623, 11.668),
        (50, 37.11, 65.92),
    ],
)
def test_poisson_limits_are_garwoods(count, low, high):
    assert poisson_limits(count) == (pytest.approx(low, abs=6e-3), pytest.approx(high, abs=6e-3))


@given(count=st.integers(0, 60), confidence=st.sampled_from([0.5, 0.95, 0.999999]))
def test_each_poisson_limit_is_wrong_with_half_of_the_rest(count, confidence):
    (low, high), tail = poisson_limits(count, confidence), (1 - confidence) / 2
    assert pdtr(count, high) == pytest.approx(tail, rel=1e-6)
    assert (pdtrc(count - 1, low) == pytest.approx(tail, rel=1e-6)) if count else (low == 0)


@pytest.mark.parametrize("bad", [0.0, 1.0, 97.5])
def test_probabilities_are_no_percents(bad):
    with pytest.raises(ValueError, match="between 0 and 1"):
        student_quantile(bad, 4)


@pytest.mark.parametrize(
    ("one", "other", "do_overlap"),
    [
        ((1.0, 2.0), (1.5, 3.0), True),
        ((1.0, 2.0), (2.0, 3.0), True),  # one value in common
        ((1.0, 2.0), (2.001, 3.0), False),
        ((1.0, None), (2.0, 3.0), True),
        ((4.0, None), (2.0, 3.0), False),
        ((None, 2.0), (-9.0, 1.0), True),
        ((None, 2.0), (3.0, 4.0), False),
        ((None, 2.0), (1.0, None), True),
        ((None, None), (None, None), True),
    ],
)
def test_ranges_overlap_where_they_have_a_value_in_common(one, other, do_overlap):
    assert ranges_overlap(one, other) is do_overlap
    assert ranges_overlap(other, one) is do_overlap


def printed(lower, upper, quantile, messages):
    interval = Interval(1.0, lower, upper, 0.95, messages, messages, Basis.WITHIN_RUN, 1, 0, None)
    return without_open_end(interval, quantile).range


def test_the_end_beyond_a_tail_of_few_messages_is_open():
    ends = [messages_to_end(quantile) for quantile in (0.5, 0.9, 0.95, 0.99, 0.999, 0.01)]
    assert ends == [1, 1, 1000, 5000, 50_000, 5000]
    assert printed(1.0, 2.0, 0.99, 4999) == (1.0, None)
    assert printed(1.0, 2.0, 0.01, 4999) == (None, 2.0)
    assert printed(1.0, 2.0, 0.99, 5000) == printed(1.0, 2.0, 0.5, 5) == printed(1.0, 2.0, None, 5) == (1.0, 2.0)
    assert printed(math.inf, math.inf, 0.99, 4999) == (math.inf, math.inf)


def test_histogram_by_hand():
    # Below 2048 ns every value has its own bucket; 4096..4099 share one of width 4.
    histogram = histogram_of(np.array([-3, 0, 1, 5, 5, 2047, 4096, 4099, 4100]))
    assert histogram.value_ns.tolist() == [-3.0, 0.0, 1.0, 5.0, 2047.0, 4097.5, 4101.5]
    assert histogram.count.tolist() == [1, 1, 1, 2, 1, 2, 1]


def test_the_largest_error_is_half_of_the_widest_bucket():
    # An octave has 1024 buckets, of which the first are the widest for their values: 1/1024.
    assert RELATIVE_ERROR == 1 / 2048


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
