"""What could have been found and how much more it takes: by hand and by drawing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.two_samples import welch_test
from dds_trace.analyzer.statistics.intervals import Basis, Interval
from dds_trace.analyzer.statistics.power import (
    _fewest,
    benjamini_hochberg_adjusted,
    confidence_at_each,
    holm_adjusted,
    messages_to_close,
    runs_to_decide,
    smallest_shift,
)


def interval(lower, upper, *, samples, independent, episodes):
    return Interval(1.0, lower, upper, 0.95, samples, independent, Basis.BETWEEN_RUNS, 5, 5, episodes)


def test_a_shift_counts_in_standard_errors():
    assert smallest_shift(0.1, 4) == pytest.approx(0.37610603, rel=1e-6)
    assert smallest_shift(0.1, 4.2) == pytest.approx(0.37610603, rel=1e-6)  # rounded down to a quarter
    assert smallest_shift(0.1, 98) == pytest.approx(0.28294147, rel=1e-6)
    assert smallest_shift(0.1, 4, power=0.9) > smallest_shift(0.1, 4)


@pytest.mark.parametrize("distance", [0.04, 0.08, 0.2])
def test_the_runs_that_it_takes_decide_in_80_of_100(distance):
    runs = runs_to_decide(distance, 0.05, 0.05)
    draws = np.random.default_rng(1).standard_normal((1500, 2, runs)) * 0.05
    decided = []
    for base, new in draws:
        test = welch_test(base, new + distance)
        decided.append(test.difference - test.reach(0.95) * test.error > 0)
    assert np.mean(decided) >= 0.77  # a standard error of 1 %
    if runs > 3:  # and one run less would not
        fewer = smallest_shift(0.05 * math.sqrt(2 / (runs - 1)), 2 * (runs - 2))
        assert fewer > distance


def test_the_runs_of_unlike_spreads_by_hand():
    # 3.7611 standard errors with four degrees of freedom: of five runs on one side 3.7611 / sqrt(5) = 1.6820 spreads.
    assert [runs_to_decide(distance, 0.1, 0.0) for distance in (0.1683, 0.1681)] == [5, 6]
    # Of three runs on both sides, which have as many degrees, 3.7611 sqrt(2 / 3) = 3.0709.
    assert [runs_to_decide(distance, 0.1, 0.1) for distance in (0.3072, 0.3070)] == [3, 4]


@pytest.mark.parametrize("spreads", [(0.3, 0.1), (0.1, 0.3)])
def test_unlike_spreads_have_degrees_between_those_of_one_side_and_both(spreads):
    # 0.1^2 / (0.3^4 + 0.1^4) = 1.22 (runs - 1) degrees: with ten runs 10.75 in whole quarters.
    enough = smallest_shift(math.sqrt(0.1 / 10), 10.75)
    assert runs_to_decide(enough * (1 - 1e-9), *spreads) == 11


def test_a_distance_that_is_just_found_is_enough():
    assert runs_to_decide(smallest_shift(math.sqrt(0.05), 4.0), 0.5, 0.0) == 5


def test_what_lies_at_the_limit_is_never_decided():
    assert runs_to_decide(0.0, 0.05, 0.05) is None
    assert runs_to_decide(1e-4, 0.05, 0.05) is None
    assert runs_to_decide(0.0, 0.0, 0.0) is None
    assert runs_to_decide(1.0, 0.1, 0.1) == runs_to_decide(-0.2, 0.0, 0.0) == 3
    assert runs_to_decide(-0.2, 0.05, 0.05) == runs_to_decide(0.2, 0.05, 0.05)


@given(distance=st.floats(0.02, 1), spread=st.floats(0.01, 0.2))
@settings(max_examples=30)
def test_more_spread_takes_more_runs(distance, spread):
    few, many = runs_to_decide(distance, spread, spread), runs_to_decide(distance, 2 * spread, 2 * spread)
    assert many is None or few <= many


@pytest.mark.parametrize(("enough", "fewest"), [(1, 3), (3, 3), (4, 4), (7, 7), (999, 999), (1000, 1000), (1001, None)])
def test_the_fewest_runs_from_three_to_a_thousand(enough, fewest):
    assert _fewest(lambda runs: runs >= enough) == fewest


def test_messages_that_close_an_interval():
    assert messages_to_close(interval(1, 2, samples=1000, independent=900, episodes=4), 0.99) == 0
    # Fifty messages beyond p99 take 5000, however few bursts they come in.
    for episodes in (0, 4, None):
        assert messages_to_close(interval(1, None, samples=1000, independent=900, episodes=episodes), 0.99) == 4000
    assert messages_to_close(interval(None, None, samples=0, independent=0, episodes=None), 0.99) is None
    # Six messages have one on each side of the median.
    assert messages_to_close(interval(1, None, samples=2, independent=1, episodes=9), 0.5) == 4


p_values = st.lists(st.floats(0, 1), max_size=20)


def test_holm_by_hand():
    # Rising 0.01, 0.02, 0.03, 0.2: times 4, 3, 2, 1 = 0.04, 0.06, 0.06, 0.2.
    assert holm_adjusted([0.03, 0.01, 0.2, 0.02]).tolist() == pytest.approx([0.06, 0.04, 0.2, 0.06])


def test_benjamini_and_hochberg_by_hand():
    # Rising 0.01, 0.02, 0.03, 0.2: times 4/1, 4/2, 4/3, 1 = 0.04, 0.04, 0.04, 0.2.
    assert benjamini_hochberg_adjusted([0.03, 0.01, 0.2, 0.02]).tolist() == pytest.approx([0.04, 0.04, 0.2, 0.04])


@pytest.mark.parametrize("adjust", [holm_adjusted, benjamini_hochberg_adjusted])
@given(values=p_values)
def test_adjusting_keeps_the_order_and_never_lowers(adjust, values):
    found = adjust(values)
    assert len(found) == len(values)
    assert all(found >= np.array(values) - 1e-15)
    assert all(found <= 1)
    order = np.argsort(values, kind="stable")
    assert (np.diff(found[order]) >= 0).all()


@given(values=p_values)
def test_holm_is_the_stricter(values):
    assert all(holm_adjusted(values) >= benjamini_hochberg_adjusted(values) - 1e-15)


def test_twenty_equal_groups_give_one_false_alarm_in_twenty_families():
    draws = np.random.default_rng(1).random((2000, 20))
    alarms = [(holm_adjusted(draw) <= 0.05).any() for draw in draws]
    assert np.mean(alarms) == pytest.approx(0.05, abs=0.015)


def test_a_twentieth_of_the_alarms_is_false():
    draws = np.random.default_rng(2).random((2000, 20))
    draws[:, :10] *= 1e-3  # ten true differences
    false = [
        (found[10:].sum() / max(1, found.sum()))
        for found in (benjamini_hochberg_adjusted(draw) <= 0.05 for draw in draws)
    ]
    assert np.mean(false) <= 0.05


def test_looks_are_stricter_by_pocock():
    levels = [round(1 - confidence_at_each(looks), 4) for looks in range(1, 11)]
    assert levels == [0.05, 0.0294, 0.0221, 0.0182, 0.0158, 0.0142, 0.0130, 0.0120, 0.0112, 0.0106]
