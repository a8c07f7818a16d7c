"""Variance components: known spreads come back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drawn_series import log_normal_groups

from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Runs, Statistic
from dds_trace.analyzer.run_statistics.spread import Spread, spread_of_runs
from dds_trace.analyzer.run_statistics.tails import inflations_of


@pytest.mark.parametrize("statistic", [Statistic(0.5), Statistic(0.9), MEAN])
def test_both_parts_come_back(statistic):
    # Deviation of the logarithm 0.5: of a median 0.5 sqrt(pi / 2 / n), of a mean sqrt((e^0.25 - 1) / n), of a p90
    # 0.5 sqrt(0.09 / n) / 0.1755 with n = 2000.
    within = {
        Statistic(0.5): 0.5 * math.sqrt(math.pi / 2 / 2000),
        Statistic(0.9): 0.5 * math.sqrt(0.09 / 2000) / 0.17550,
        MEAN: math.sqrt((math.exp(0.25) - 1) / 2000),
    }[statistic]
    groups = log_normal_groups(20, 20, 2000, 0.08, seed=1)
    found = [spread_of_runs([Run(values) for values in group], statistic) for group in groups]
    assert np.mean([spread.between for spread in found]) == pytest.approx(0.08, rel=0.1)
    assert np.mean([spread.within for spread in found]) == pytest.approx(within, rel=0.15)


def test_dependence_counts_as_within():
    # A correlation of 0.8 makes a mean of logarithms sqrt(9) times as uncertain; of the median about 2.6 times.
    groups = log_normal_groups(10, 10, 2000, 0.0, seed=2, correlation=0.8)
    found = [spread_of_runs([Run(values) for values in group], Statistic(0.5)) for group in groups]
    assert np.mean([spread.between for spread in found]) < 0.02
    assert np.mean([spread.within for spread in found]) > 0.03


def test_what_has_no_logarithm_has_no_spread():
    lost = [Run(np.full(100, math.inf)), Run(np.arange(1.0, 101))]
    assert spread_of_runs(lost, Statistic(0.5)) == Spread(None, None)
    assert spread_of_runs([], MEAN) == Spread(None, None)
    assert spread_of_runs([Run(np.arange(5))], Statistic(0.5)) == Spread(None, None)
    one = spread_of_runs([Run(np.random.default_rng(1).random(1000) + 1)], Statistic(0.5))
    assert one.between is None
    assert 0.005 < one.within < 0.02


@pytest.mark.parametrize("missing", [0.0, math.inf])
def test_an_error_that_reaches_what_has_no_logarithm_is_unknown(missing):
    # The median of 100 is finite and above zero, and one standard error beside it 46 of them are not.
    values = np.arange(100.0, 200.0)
    values[np.arange(46) * 2] = missing
    assert 100 < Statistic(0.5).of_run(Run(values)) < 200
    assert spread_of_runs([Run(values)], Statistic(0.5)) == Spread(None, None)


@pytest.mark.parametrize(("quantile", "steps"), [(0.99, (0.0, 0.995)), (0.01, (0.005, 0.0))])
def test_an_error_ends_half_a_message_before_the_end(quantile, steps):
    run = Run(np.exp(np.random.default_rng(1).standard_normal(100)))
    ((inflation,),) = inflations_of(Runs((run,)), [quantile])
    error = math.sqrt(0.99 * 0.01 * max(1.0, inflation) / 100)
    low, high = steps[0] or quantile - error, steps[1] or quantile + error
    ends = np.quantile(run.values, [low, high], method="median_unbiased")
    found = spread_of_runs([run], Statistic(quantile)).within
    assert found == pytest.approx(math.log(ends[1] / ends[0]) * error / (high - low))
