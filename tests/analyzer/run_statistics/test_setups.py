from __future__ import annotations

import numpy as np
import pytest

from dds_trace.analyzer.run_statistics.setups import RunLogarithms, setup_means, spreads_are_alike, spreads_more

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
    assert spreads_more(QUIET[np.newaxis], 0) is False
    assert spreads_more(np.zeros((3, 3)), 0) is False
