import math
from statistics import NormalDist

import numpy as np
import pytest
from drawn_series import autoregressive
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.between_runs import has_few_bursts, interval_of_runs
from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Statistic
from dds_trace.analyzer.statistics.intervals import Basis

P50, P99 = Statistic(0.5), Statistic(0.99)


def test_a_short_series_by_hand():
    # 22 values, too few to estimate how they depend; Student's price of 1.236 leaves 17. binomial(17, 1/2): P(B <= 4)
    # = 0.0245, so the 5th and the 13th of 17; of 22 the 1 + floor(4 * 22/17) = 6th and the ceil(13 * 22/17) = 17th.
    # The eleven above the median alternate with those below: eleven episodes.
    values = np.array([4, 20, 9, 13, 1, 17, 11, 12, 6, 22, 2, 15, 8, 19, 3, 14, 10, 21, 5, 16, 7, 18])
    found = interval_of_runs([Run(values)], P50)
    assert (found.lower, found.value, found.upper) == (6.0, 11.5, 17.0)
    assert (found.samples, found.independent, found.episodes) == (22, 17, 11)
    assert (found.basis, found.runs, found.units) == (Basis.WITHIN_RUN, 1, 0)


def test_what_a_run_does_not_support_has_no_value():
    found = interval_of_runs([Run(np.arange(99))], P99)
    assert (found.value, found.lower, found.upper, found.samples) == (None, None, None, 99)
    assert interval_of_runs([Run(np.arange(100))], P99).value == pytest.approx(0.99 * 99)
    assert interval_of_runs([], P50).value is None


def test_an_outage_is_one_episode_that_the_end_reaches():
    values = np.random.default_rng(1).random(5000) + 1
    values[2000:2100] = math.inf
    new = interval_of_runs([Run(values)], P99)
    assert new.independent < 100
    assert (new.value, new.upper, new.episodes) == (math.inf, math.inf, 1)
    assert new.lower is not None
    assert new.lower < 2


def test_bursts_are_few_below_six_and_below_half_of_the_messages_of_a_tail():
    assert [has_few_bursts(episodes, 3000, 0.99) for episodes in (5, 6, None)] == [True, False, False]
    assert [has_few_bursts(episodes, 1000, 0.01) for episodes in (4, 5)] == [True, False]
    assert not has_few_bursts(1, 3000, None)


def test_many_outages_close_the_end():
    values = np.random.default_rng(1).random(20_000) + 1
    values[np.add.outer(np.arange(250, 20_000, 500), np.arange(20)).ravel()] = math.inf
    found = interval_of_runs([Run(values)], P99)
    assert (found.lower, found.value, found.upper, found.episodes) == (math.inf, math.inf, math.inf, 40)


def test_the_lower_tail_is_open_below():
    values = np.random.default_rng(1).random(2000) + 1
    values[700:720] = 0
    found = interval_of_runs([Run(values)], Statistic(0.01))
    assert found.episodes == 1
    assert found.lower is None
    assert found.upper is not None


def test_equal_values_are_an_interval():
    found = interval_of_runs([Run(np.full(5000, 7))], P99)
    assert (found.lower, found.value, found.upper, found.episodes) == (7.0, 7.0, 7.0, None)


def test_a_mean_by_hand():
    found = interval_of_runs([Run(np.full(100, 3.0))], MEAN)
    assert (found.lower, found.value, found.upper, found.independent) == (3.0, 3.0, 3.0, 100)
    lost = interval_of_runs([Run(np.array([1.0, math.inf] * 20))], MEAN)
    assert (lost.lower, lost.value, lost.upper) == (None, math.inf, math.inf)
    assert interval_of_runs([Run(np.arange(10))], MEAN).lower is None  # too few to see how they depend


def test_a_mean_has_ends_from_25_messages_on():
    few, enough = (interval_of_runs([Run(np.arange(messages))], MEAN) for messages in (24, 25))
    assert (few.lower, few.value, few.upper, few.independent) == (None, 11.5, None, 24)
    assert enough.lower < 12 < enough.upper


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.95])
def test_nineteen_of_twenty_means_are_held(correlation):
    found = [interval_of_runs([Run(run)], MEAN) for run in autoregressive(400, 2000, correlation, seed=3)]
    held = np.mean([i.lower <= 0 <= i.upper for i in found])
    assert 0.92 <= held <= 0.99


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("quantile", [0.5, 0.9])
def test_nineteen_of_twenty_quantiles_are_held(correlation, quantile):
    true = NormalDist().inv_cdf(quantile)
    found = [
        interval_of_runs([Run(run)], Statistic(quantile)) for run in autoregressive(400, 2000, correlation, seed=4)
    ]
    assert np.mean([i.is_two_sided for i in found]) > 0.9
    held = np.mean([i.lower <= true <= i.upper for i in found if i.is_two_sided])
    assert 0.92 <= held <= 0.995  # 400 draws: a standard error of 1.1 %


@given(
    values=st.lists(st.integers(0, 10**9) | st.just(math.inf), min_size=100, max_size=300),
    q=st.sampled_from([0.5, 0.9, 0.95, 0.99]),
)
def test_ends_enclose_the_value(values, q):
    found = interval_of_runs([Run(np.array(values, np.float64))], Statistic(q))
    assert found.lower is None or found.lower <= found.value
    assert found.upper is None or found.value <= found.upper
    assert 1 <= found.independent <= found.samples
