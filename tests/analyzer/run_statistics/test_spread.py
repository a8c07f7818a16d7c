"""Variance components: known spreads come back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drawn_series import log_normal_groups

from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Statistic
from dds_trace.analyzer.run_statistics.spread import Spread, spread_of_runs


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
