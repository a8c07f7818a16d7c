from __future__ import annotations

import math

import numpy as np
import pytest

from dds_trace.analyzer.run_statistics.late_share import late_share
from dds_trace.analyzer.run_statistics.runs import Run, Runs

MS = 1e6


def runs_at(levels, messages=300, seed=0):
    """Runs whose messages spread by 10 % around a level in ms."""
    draws = np.random.default_rng(seed)
    return Runs(tuple(Run(level * MS * np.exp(0.1 * draws.standard_normal(messages))) for level in levels))


def test_what_was_late_or_lost_is_the_observed_share():
    share = late_share(Runs((Run(np.array([1, 3, np.inf, 2]) * MS),)), 2 * MS)
    assert (share.observed, share.lower, share.upper) == (0.5, None, None)
    assert late_share(Runs((Run(np.empty(0)),)), 2 * MS) is None
    assert late_share(Runs((Run(np.full(9, np.inf)),) * 3), 2 * MS).upper == 1.0


def test_equal_runs_far_from_the_deadline_have_no_late_message_and_a_limit_of_none():
    share = late_share(runs_at([1] * 5), 3 * MS)
    assert share.observed == share.lower == 0.0
    assert share.upper < 1e-3


@pytest.mark.parametrize(("levels", "late"), [([1] * 18 + [3] * 2, 0.1), ([1, 1, 3, 1, 1], 0.2)])
def test_two_of_twenty_runs_wholly_late_are_a_tenth_of_the_messages(levels, late):
    share = late_share(runs_at(levels), 2 * MS)
    assert share.observed == pytest.approx(late)
    assert share.upper > 0.2
    assert share.lower == 0.0


@pytest.mark.parametrize("runs", [3, 5, 20])
def test_of_runs_that_spread_by_a_fifth_few_limits_are_below_a_true_share_of_2_percent(runs):
    """By Student's limit of the late shares alone 25 to 70 of 100 are."""
    draws, spread = np.random.default_rng(runs), 0.2
    deadline_ns = MS * math.exp(2.0537 * math.hypot(spread, 0.1))  # the 98 % quantile of the normal distribution
    below = 0
    for seed in range(60):
        share = late_share(runs_at(np.exp(spread * draws.standard_normal(runs)), seed=seed), deadline_ns)
        below += share.observed <= 0.01 and share.upper <= 0.01
    assert below <= 4
