import gc
import math
import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.bursts import positions_of
from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Runs, Statistic, joined_runs, quantile_at
from dds_trace.analyzer.run_statistics.setups import RunLogarithms, setup_means, spreads_are_alike, spreads_more
from dds_trace.analyzer.run_statistics.spread import spread_of_runs


@given(values=st.lists(st.integers(0, 10**12), min_size=1, max_size=80), q=st.floats(0.01, 0.99))
def test_quantiles_are_numpys_median_unbiased(values, q):
    found = Statistic(q).of_run(Run(np.array(values, np.int64)))
    assert found == pytest.approx(float(np.quantile(values, q, method="median_unbiased")), rel=1e-9, abs=1e-3)


def test_a_statistic_by_hand():
    run = Run(np.array([40, 10, 30, 20]))
    # Definition 8: position (4 + 1/3) / 2 + 1/3 = 2.5.
    assert Statistic(0.5).of_run(run) == 25.0
    assert Statistic(0.99).of_run(run) == 40.0
    assert MEAN.of_run(run) == 25.0
    assert (MEAN.needs, Statistic(0.5).needs, Statistic(0.99).needs) == (1, 1, 100)


def test_lost_messages_are_infinitely_late():
    run = Run(np.array([1.0, math.inf, 2.0, math.inf]))
    assert Statistic(0.5).of_run(run) == math.inf
    assert Statistic(0.3).of_run(run) < 2
    assert MEAN.of_run(run) == math.inf
    assert quantile_at(np.array([math.inf, math.inf]), 1.5) == math.inf
    assert quantile_at(np.array([1.0, 2.0, math.inf]), 2.0) == 2.0


def test_joined_runs_follow_each_other_in_time():
    first = Run(np.array([1, 2, 3]), np.array([100, 110, 120]))
    second = Run(np.array([4, 5]), np.array([5_000, 5_020]))
    joined = joined_runs([first, second])
    assert joined.values.tolist() == [1, 2, 3, 4, 5]
    assert np.diff(joined.sent_ns).tolist() == [10, 10, 20, 20]
    third, one = Run(np.array([6, 7, 8]), np.array([50, 70, 110])), Run(np.array([9]), np.array([7]))
    assert np.diff(joined_runs([first, third, one]).sent_ns).tolist() == [10, 10, 30, 20, 40, 0]
    empty = Run(np.empty(0), np.empty(0, np.int64))
    assert np.diff(joined_runs([first, empty, second]).sent_ns).tolist() == [10, 10, 20, 20]
    assert joined_runs([first]) is first
    assert len(joined_runs([])) == 0
    assert joined_runs([first, Run(np.array([7]))]).sent_ns is None


def test_the_values_of_two_runs_in_order():
    first, second = Run(np.array([5, 1, 3])), Run(np.array([4, 2]))
    assert Runs((first, second)).ordered.tolist() == [1, 2, 3, 4, 5]
    assert Runs((first, second)).ordered_by_run.tolist() == [1, 3, 5, 2, 4]
    assert Runs((first,)).ordered.tolist() == [1, 3, 5]


@pytest.mark.parametrize("count", [1, 3])
def test_runs_that_nobody_uses_are_gone_at_once(count):
    """What is kept of a run of millions of messages is hundreds of megabytes, which must not wait for the collector."""
    runs = Runs(tuple(Run(np.arange(200), np.arange(200)) for _ in range(count)))
    interval_of_runs(runs, Statistic(0.9))
    spread_of_runs(runs, Statistic(0.9))
    array = weakref.ref(runs.ordered)
    gc.disable()
    try:
        del runs
        assert array() is None
    finally:
        gc.enable()


def test_positions_of_runs_side_by_side_are_those_of_each():
    """Also of a run without times between others, of one message alone, and of one that has none beyond."""
    draw = np.random.default_rng(0)
    lengths = (40, 1, 25, 30)
    runs = Runs(
        tuple(
            Run(draw.normal(size=n), None if n == 25 else 10**18 + np.cumsum(draw.integers(1, 10**9, n)))
            for n in lengths
        )
    )
    is_meant = draw.random(sum(lengths)) < 0.4
    is_meant[40:41], is_meant[66:] = True, False
    indices = is_meant.nonzero()[0]
    offsets = indices.searchsorted(runs.offsets)
    positions = np.split(runs.positions(indices, offsets), offsets[1:-1])
    expected = [
        positions_of(mask.nonzero()[0], run.sent_ns)
        for run, mask in zip(runs, np.split(is_meant, np.cumsum(lengths)[:-1]), strict=True)
    ]
    for found, own in zip(positions, expected, strict=True):
        assert found.tolist() == own.tolist()
    assert len(expected[1]) == 1
    assert len(expected[3]) == 0


QUIET = np.array([-1.0, 0.2, 0.8])


def means_of(*rows, repeats=(0, 1, 2)):
    return setup_means({(kind, "a"): RunLogarithms(np.array(row), repeats) for kind, row in enumerate(rows)})


def test_alike_spreads_are_one():
    rows = [QUIET, 1.2 * QUIET[::-1] + 3, 0.9 * QUIET[[1, 2, 0]] - 2]
    means = means_of(*rows)
    pooled = np.mean([np.var(row, ddof=1) for row in rows])
    for kind, row in enumerate(rows):
        assert means[kind, "a"].mean == pytest.approx(row.mean())
        assert means[kind, "a"].variance == pytest.approx(pooled / 3)
        assert means[kind, "a"].degrees > 2


def test_runs_that_move_together_count_once():
    means = means_of(QUIET, QUIET, QUIET)
    assert means[0, "a"].degrees == pytest.approx(2)


def residuals_of(others, times):
    """Residuals of unit variance that move apart, and of one more kind with so many times their variance."""
    drawn = np.random.default_rng(3).standard_normal((others, 3))
    drawn -= drawn.mean(axis=1, keepdims=True)
    unit = drawn / drawn.std(axis=1, ddof=1, keepdims=True)
    return np.array([*unit, np.sqrt(times) * QUIET / QUIET.std(ddof=1)])


def test_one_noisy_kind_keeps_its_spread():
    residuals = residuals_of(19, 9)
    assert spreads_are_alike([residuals])
    assert [spreads_are_alike([residuals_of(1, times)]) for times in (7, 7.1)] == [True, False]  # of Bartlett's 1.323
    means = means_of(*residuals)
    assert (means[19, "a"].variance, means[19, "a"].degrees) == pytest.approx((3.0, 2.0))
    assert means[0, "a"].variance == pytest.approx((19 + 9) / 20 / 3)
    assert 3 < means[0, "a"].degrees <= 4


@pytest.mark.parametrize(("times", "more"), [(2.0, False), (6.5, False), (8.0, True), (16.0, True)])
def test_more_is_judged_by_an_f_test(times, more):
    # Three repeats of any number of kinds have at most (3 - 1) squared degrees: P(F > 6.94) = 5 % of 2 and 4.
    assert spreads_more(residuals_of(19, times), 19) is more
    assert spreads_more(residuals_of(19, times), 0) is False


def test_one_kind_has_no_others():
    assert spreads_more(residuals_of(1, 20.0), 1) is True  # P(F > 19) = 5 % of 2 and 2
    assert spreads_more(QUIET[np.newaxis], 0) is False
    assert spreads_more(np.zeros((3, 3)), 0) is False
