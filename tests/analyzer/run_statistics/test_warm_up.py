import math
from itertools import product

import numpy as np
import pytest
from drawn_series import autoregressive
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.modes import WarmUp, find_warm_up, medians_of_five, mser_truncation


def test_the_begin_that_costs_most_is_left_out():
    assert mser_truncation(np.array([9.0, 9, 1, 2, 1, 2, 1, 2, 1, 2])) == 2
    assert mser_truncation(np.array([1.0, 2, 1, 2, 1, 2, 1, 2])) == 0
    assert mser_truncation(np.array([5.0] * 8)) == 0


@pytest.mark.parametrize("rest", [0.0, 0.1, 1.7, 123.4])
def test_no_more_is_left_out_where_the_rest_is_constant(rest):
    """Of a clock that ticks coarsely, say; rounding alone would choose among the values that are alike."""
    assert mser_truncation(np.array([rest + 2.08, rest + 0.69] + [rest] * 38)) == 2
    series = np.exp([rest / 100 + 2.08] * 5 + [rest / 100 + 0.69] * 5 + [rest / 100] * 190)
    assert find_warm_up(series).messages == 10


@given(values=st.lists(st.floats(-100, 100), min_size=8, max_size=60))
def test_the_criterion_is_whites(values):
    series = np.array(values)
    n = len(series)
    direct = [float(np.square(series[d:] - series[d:].mean()).sum() / (n - d) ** 2) for d in range(n // 4 + 1)]
    assert direct[mser_truncation(series)] == pytest.approx(min(direct), abs=1e-9)


def test_the_median_of_five_is_that_of_every_order():
    """Of equal values, too: five places of five values each."""
    batches = np.array(list(product(range(5), repeat=5)))
    assert medians_of_five(batches).tolist() == np.median(batches, axis=1).tolist()


def test_twenty_slow_messages_are_found():
    slow = np.where(np.arange(1000) < 20, 3, 1)
    found = [find_warm_up(slow * np.exp(0.5 * run)) for run in autoregressive(100, 1000, 0.0, seed=1)]
    sure = [warm_up for warm_up in found if warm_up.is_sure(0.1)]
    assert len(sure) >= 75
    assert np.median([warm_up.messages for warm_up in sure]) == 20
    assert np.median([warm_up.ratio for warm_up in sure]) == pytest.approx(3, rel=0.1)


def test_a_level_that_decays_is_found():
    decay = 1 + 2 * np.exp(-np.arange(1000) / 50)
    found = [find_warm_up(decay * np.exp(0.5 * run)) for run in autoregressive(100, 1000, 0.0, seed=2)]
    assert np.mean([warm_up.is_sure(0.1) for warm_up in found]) >= 0.9
    assert 50 <= np.median([warm_up.messages for warm_up in found]) <= 150


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.95])
def test_runs_without_a_warm_up_rarely_have_one(correlation):
    runs = np.exp(0.5 * autoregressive(500, 1000, correlation, seed=3))
    assert np.mean([find_warm_up(run).is_sure() for run in runs]) <= 0.01


def test_a_burst_later_on_is_no_warm_up():
    generator = np.random.default_rng(4)
    false = []
    for run in autoregressive(300, 1000, 0.0, seed=4):
        values = np.exp(0.3 * run)
        for begin in generator.integers(50, 980, 2):
            values[begin : begin + 20] *= 5
        false.append(find_warm_up(values).is_sure())
    assert np.mean(false) <= 0.03


def test_short_and_constant_runs():
    assert find_warm_up(np.ones(199)) is None
    constant = find_warm_up(np.full(500, 7))
    assert (constant.messages, constant.ratio, constant.is_sure()) == (0, 1.0, False)
    step = find_warm_up(np.array([20] * 25 + [10] * 475))
    assert (step.messages, step.is_sure()) == (25, True)
    assert step.ratio == pytest.approx(2)
    assert math.isclose(step.p_value, 0.0)


def test_what_is_sure_begins_at_its_limits():
    assert WarmUp(5, 2.0, 1e-3).is_sure(1.0)
    assert WarmUp(5, 0.5, 1e-3).is_sure(1.0)  # half as slow is as far from the rest
    assert WarmUp(1, 1.0, 0.0).is_sure()
    assert not WarmUp(5, 1.1, 1e-3).is_sure(0.2)
    assert not WarmUp(5, 2.0, 1e-3).is_sure(1.001)
    assert not WarmUp(5, 2.0, 1.001e-3).is_sure(1.0)
    assert not WarmUp(0, 2.0, 1e-3).is_sure()


def test_the_shortest_run_that_tells():
    run = np.array([20.0] * 10 + [10.0, 11.0] * 95)
    assert find_warm_up(run).messages == 10
    assert find_warm_up(run[:-1]) is None


def test_the_first_batch_of_a_short_begin_is_like_its_others():
    rest = [10.0, 11.0] * 95
    assert find_warm_up(np.array([40.0] * 20 + rest)).messages == 20
    assert find_warm_up(np.array([12.0] * 5 + [40.0] * 15 + rest)).messages == 0  # it came later
