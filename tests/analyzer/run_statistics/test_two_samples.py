import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.two_samples import (
    fieller_ends,
    mover_ends,
    paired_test,
    permutation_p_value,
    welch_test,
)
from dds_trace.extensions.gates.detectable import probability_of_superiority

numbers = st.lists(st.floats(-100, 100), min_size=3, max_size=8)


def test_welch_by_hand():
    # Means 2 and 5, variances 1 and 8/3, three and four values: squared errors 1/3 and 2/3.
    test = welch_test(np.array([1.0, 2, 3]), np.array([3.0, 5, 5, 7]))
    assert test.difference == 3
    assert test.error == pytest.approx(1)
    # (1/3 + 2/3)^2 / ((1/3)^2 / 2 + (2/3)^2 / 3) = 1 / (1/18 + 4/27)
    assert test.degrees == pytest.approx(1 / (1 / 18 + 4 / 27))
    assert test.p_value == pytest.approx(0.030801487692069, rel=1e-9)  # scipy.stats.ttest_ind, equal_var=False
    assert test.pairs == 0


def test_pairs_by_hand():
    # Differences 1, 2, 3: mean 2, deviation 1, t = 2 sqrt(3) with two degrees: p = 1 - t / sqrt(t^2 + 2).
    test = paired_test(np.array([10.0, 20, 30]), np.array([11.0, 22, 33]))
    assert (test.difference, test.degrees, test.pairs) == (2, 2, 3)
    assert test.error == pytest.approx(1 / math.sqrt(3))
    assert test.p_value == pytest.approx(1 - math.sqrt(12 / 14), rel=1e-9)


def test_samples_without_spread_are_surely_different_or_surely_equal():
    assert welch_test(np.ones(3), np.ones(3)).p_value == 1.0
    assert welch_test(np.ones(3), np.full(4, 2.0)).p_value == 0.0
    assert welch_test(np.ones(3), np.full(4, 2.0)).degrees == 5


@given(base=numbers, new=numbers)
def test_sides_can_be_exchanged(base, new):
    one, other = welch_test(np.array(base), np.array(new)), welch_test(np.array(new), np.array(base))
    assert one.difference == pytest.approx(-other.difference)
    assert one.p_value == pytest.approx(other.p_value)
    assert 0 <= one.p_value <= 1


def test_the_ends_of_a_difference_by_hand():
    # 5 (4 to 8) less 2 (1 to 2.5): 3 - sqrt(1 + 0.25), 3 + sqrt(9 + 1).
    low, high = mover_ends((2, 1, 2.5), (5, 4, 8))
    assert (low, high) == (pytest.approx(3 - math.sqrt(1.25)), pytest.approx(3 + math.sqrt(10)))


def test_the_ends_of_a_ratio_are_where_the_test_turns():
    above, below = np.array([2.0, 2.2, 1.9, 2.1]), np.array([1.0, 1.1, 0.95, 1.05])
    test = welch_test(above, below)
    low, high = fieller_ends(above, below, test, 0.95)
    assert low < 2 < high
    for end in (low, high):
        error = math.hypot(above.std(ddof=1) / 2, end * below.std(ddof=1) / 2)
        assert abs(above.mean() - end * below.mean()) / error == pytest.approx(test.reach(0.95))


def test_a_ratio_to_nothing_has_no_end():
    some, none = np.array([1.0, 1.1, 0.9]), np.zeros(3)
    assert fieller_ends(some, none, welch_test(some, none), 0.95) == (math.inf, math.inf)
    assert fieller_ends(none, some, welch_test(none, some), 0.95)[0] == 0.0
    mixed = np.array([0.0, 0.0, 1.0])
    low, high = fieller_ends(some, mixed, welch_test(some, mixed), 0.95)
    assert 0 < low < 3
    assert high == math.inf


def test_how_often_one_of_a_side_is_faster_is_a_count_of_pairs():
    assert probability_of_superiority(np.array([1.0, 2, 3]), np.array([0.0])) == 1.0
    assert probability_of_superiority(np.array([1.0, 2, 3]), np.array([9.0])) == 0.0
    # 2 is below 3, 4 and inf, and equal to 2; inf is equal to inf: (3.5 + 0.5) of eight pairs.
    assert probability_of_superiority(np.array([2.0, 3, 4, np.inf]), np.array([2.0, np.inf])) == 0.5
    assert probability_of_superiority(np.empty(0), np.ones(1)) is None
    assert probability_of_superiority(np.ones(1), np.empty(0)) is None
    draw = np.random.default_rng(1)
    for _ in range(10):
        base, new = (np.sort(draw.integers(0, 6, int(draw.integers(1, 9)))) for _ in range(2))
        pairs = [(other < one) + (other == one) / 2 for one in base for other in new]
        assert probability_of_superiority(base, new) == pytest.approx(np.mean(pairs), rel=1e-12)


@pytest.mark.parametrize(
    ("base", "new", "p_value"),
    [
        ([1, 1, 1, 1, 1], [0, 0, 0, 0, 0], 2 / 252),  # Fisher's exact test of 5 of 5 against none
        ([1, 1, 1, 1, 0], [0, 0, 0, 0, 0], 2 * math.comb(6, 1) / 252),
        ([1, 1, 1], [0, 0, 0], 2 / 20),
        ([1, 2, 3], [1, 2, 3], 1.0),
        ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], 2 / 20),
        ([1] * 10, [0] * 10, 0.0),  # 184,756 ways are too many
    ],
)
def test_permutations_by_hand(base, new, p_value):
    assert permutation_p_value(np.array(base, float), np.array(new, float)) == pytest.approx(p_value)
