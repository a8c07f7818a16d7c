import math

import numpy as np
import pytest
from drawn_series import change_of_runs

from dds_trace.analyzer.run_statistics.change import Verdict, detectable_changes, smallest_detectable_ratio
from dds_trace.analyzer.run_statistics.runs import Run, Statistic
from dds_trace.analyzer.statistics.power import benjamini_hochberg_adjusted

P50 = Statistic(0.5)
CONFIDENCE, SAME_WITHIN = 0.95, 0.05
TRIALS = 150


def changes_of(pairs, ratio=1.0):
    return [change_of_runs([Run(one) for one in base], [Run(ratio * one) for one in new], P50) for base, new in pairs]


def share_called_slower(changes, groups):
    """Share of the changes that are called slower beside so many less one groups that did not change."""
    chance = np.random.default_rng(8)

    def is_called(change):
        adjusted = benjamini_hochberg_adjusted(np.array([change.p_value, *chance.uniform(size=groups - 1)]))
        return change.verdict(SAME_WITHIN) is Verdict.WORSE and adjusted[0] <= 1 - CONFIDENCE

    return np.mean([is_called(change) for change in changes])


def drawn_pairs(runs, spread, seed):
    levels = np.exp(spread * np.random.default_rng(seed).standard_normal((2 * TRIALS, runs, 1)))
    drawn = levels * np.ones(9)
    return list(zip(drawn[::2], drawn[1::2], strict=True))


@pytest.mark.parametrize(
    ("groups", "runs", "spread"), [(1, 3, 0.05), (60, 5, 0.02), (8, 5, 0.001)], ids=["one", "many", "band"]
)
def test_the_smallest_change_is_seen_in_80_of_100_whichever_group_it_is(groups, runs, spread):
    pairs = drawn_pairs(runs, spread, seed=groups)
    told = [smallest_detectable_ratio(one, groups, CONFIDENCE, SAME_WITHIN) for one in changes_of(pairs)]
    smallest = math.exp(np.mean(np.log(told)))
    assert 0.7 <= share_called_slower(changes_of(pairs, smallest), groups) <= 0.88
    assert share_called_slower(changes_of(pairs, math.sqrt(smallest)), groups) <= 0.35


def test_the_group_that_sees_least_counts_and_others_are_counted():
    (steady_pair,), (wild_pair,) = (drawn_pairs(3, spread, seed=1)[:1] for spread in (0.01, 0.1))
    steady, wild, short = changes_of([steady_pair, wild_pair, [side[:2] for side in steady_pair]])
    named = [("latency", "p50", number, one) for number, one in enumerate((steady, wild, short))]
    alone, both = (detectable_changes(some, CONFIDENCE, SAME_WITHIN)[0] for some in (named[:1], named))
    assert (both.metric, both.statistic, both.groups, both.told) == ("latency", "p50", 3, 2)
    assert both.smallest_ratio == smallest_detectable_ratio(wild, 2, CONFIDENCE, SAME_WITHIN)
    assert both.least_ratio == smallest_detectable_ratio(steady, 2, CONFIDENCE, SAME_WITHIN)
    assert (both.least_result, both.most_result) == (0, 1)
    assert alone.smallest_ratio < smallest_detectable_ratio(steady, 2, CONFIDENCE, SAME_WITHIN) < both.smallest_ratio
    assert detectable_changes(named[2:], CONFIDENCE, SAME_WITHIN)[0].smallest_ratio is None
