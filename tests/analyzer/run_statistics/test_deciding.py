"""Runs that a gate still takes: by the spread of those that were measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.change import change_of_runs
from dds_trace.analyzer.run_statistics.runs import Run, Statistic
from dds_trace.analyzer.run_statistics.spread import runs_to_settle_ratio, runs_to_settle_value
from dds_trace.analyzer.statistics.power import runs_to_decide

P50 = Statistic(0.5)
LEVELS = np.exp([0.0, 0.05, -0.05, 0.02, -0.02])
SPREAD = float(np.log(LEVELS).std(ddof=1))


def constant_runs(levels):
    return [Run(np.full(100, level)) for level in levels]


def test_a_ratio_and_its_limit():
    change = change_of_runs(constant_runs(LEVELS), constant_runs(1.06 * LEVELS), P50)
    wanted = runs_to_decide(math.log(1.06 / 1.1), SPREAD, SPREAD)
    assert runs_to_settle_ratio(change, 1.1) == wanted > 5
    assert runs_to_settle_ratio(change, 1.06) is None  # at the limit
    assert runs_to_settle_ratio(change, 2.0) == 3


def test_pairs_are_counted_by_their_differences():
    noise = np.exp([0.01, -0.01, 0.0, 0.005, -0.005])
    order = (range(5), range(5))
    change = change_of_runs(constant_runs(LEVELS), constant_runs(1.06 * LEVELS * noise), P50, passes=order)
    of_differences = float(np.log(noise).std(ddof=1))
    assert runs_to_settle_ratio(change, 1.1) == runs_to_decide(math.log(1.06 / 1.1), of_differences, 0.0)


def test_a_value_and_its_limit():
    interval = interval_of_runs(constant_runs(20e6 * LEVELS), P50)
    assert runs_to_settle_value(interval, 21e6) == runs_to_decide(math.log(20 / 21), SPREAD, 0.0)
    assert runs_to_settle_value(interval_of_runs(constant_runs([math.inf] * 3), P50), 21e6) is None


def test_joined_runs_count_as_what_they_are_joined_of():
    # Ten runs of 60 messages are too few for p99: units of two or more runs each.
    generator = np.random.default_rng(1)
    interval = interval_of_runs(
        [Run(np.exp(generator.standard_normal(60))) for _ in range(10)], Statistic(0.99)
    )
    units = runs_to_decide(math.log(1 / 1.5), interval.unit_spread, 0.0)
    assert interval.units < 10
    assert runs_to_settle_value(interval, 1.5 * interval.value) == math.ceil(units * 10 / interval.units)


def test_one_run_does_not_tell_how_runs_spread():
    one = change_of_runs(constant_runs([1.0]), constant_runs([1.05]), P50)
    assert runs_to_settle_ratio(one, 1.1) is None


@pytest.mark.parametrize("value", [None, -1.0, 0.0, math.inf])
def test_what_has_no_logarithm_is_never_settled(value):
    change = change_of_runs(constant_runs(LEVELS), constant_runs(LEVELS), P50)
    assert runs_to_settle_ratio(replace(change, ratio=value), 1.1) is None
    assert runs_to_settle_value(replace(change.base, value=value), 1.1) is None


def test_values_below_one_have_a_logarithm():
    change = change_of_runs(constant_runs(LEVELS), constant_runs(0.95 * LEVELS), P50)
    assert runs_to_settle_ratio(change, 0.9) == runs_to_decide(math.log(0.95 / 0.9), SPREAD, SPREAD)
    assert runs_to_settle_value(change.new, 0.9) == runs_to_decide(math.log(0.95 / 0.9), SPREAD, 0.0)
