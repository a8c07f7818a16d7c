import math
from dataclasses import replace

import numpy as np
import pytest
from drawn_series import change_of_runs, log_normal_groups

from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.change import Verdict
from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Runs, Statistic
from dds_trace.analyzer.run_statistics.spread import Spread, runs_to_settle_ratio, runs_to_settle_value, spread_of_runs
from dds_trace.analyzer.run_statistics.tails import inflations_of
from dds_trace.analyzer.statistics.power import benjamini_hochberg_adjusted, runs_to_decide
from dds_trace.extensions.gates.detectable import _error_of, detectable_changes, smallest_detectable_ratio


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
    interval = interval_of_runs([Run(np.exp(generator.standard_normal(60))) for _ in range(10)], Statistic(0.99))
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


CONFIDENCE, SAME_WITHIN = 0.95, 0.05
TRIALS = 150


def changes_of(pairs, ratios=None):
    ratios = ratios or [1.0] * len(pairs)
    return [
        change_of_runs([Run(one) for one in base], [Run(ratio * one) for one in new], P50)
        for (base, new), ratio in zip(pairs, ratios, strict=True)
    ]


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
    """What equal sides name, further sides of the same kind find."""
    told = [seen_from(one, groups) for one in changes_of(drawn_pairs(runs, spread, seed=groups))]
    further = drawn_pairs(runs, spread, seed=groups + 1000)
    assert 0.74 <= share_called_slower(changes_of(further, told), groups) <= 0.9
    assert share_called_slower(changes_of(further, [math.sqrt(ratio) for ratio in told]), groups) <= 0.4


def seen_from(change, groups):
    error = _error_of(change, CONFIDENCE)
    return smallest_detectable_ratio(error, [error], groups, CONFIDENCE, SAME_WITHIN)


def test_the_group_that_sees_least_counts_and_others_are_counted():
    (steady_pair,), (wild_pair,) = (drawn_pairs(3, spread, seed=1)[:1] for spread in (0.01, 0.1))
    steady, wild, short = changes_of([steady_pair, wild_pair, [side[:2] for side in steady_pair]])
    named = [("latency", "p50", number, one) for number, one in enumerate((steady, wild, short))]
    alone, both = (detectable_changes(some, CONFIDENCE, SAME_WITHIN)[0] for some in (named[:1], named))
    assert (both.metric, both.statistic, both.groups, both.told) == ("latency", "p50", 3, 2)
    assert both.smallest_ratio == seen_from(wild, 2)
    assert both.least_ratio == seen_from(steady, 2)
    assert (both.least_result, both.most_result) == (0, 1)
    assert alone.smallest_ratio < seen_from(steady, 2) < both.smallest_ratio
    assert detectable_changes(named[2:], CONFIDENCE, SAME_WITHIN)[0].smallest_ratio is None


def test_a_statistic_that_moves_with_others_of_its_result_is_found_among_all_that_are_tested():
    """The level of an adjusted verdict depends on the tests of all metrics and statistics, and on its rank among its result's own."""
    (steady_pair,), (wild_pair,) = (drawn_pairs(3, spread, seed=1)[:1] for spread in (0.01, 0.1))
    steady, wild = changes_of([steady_pair, wild_pair])
    p50, p99 = detectable_changes([("latency", "p50", 0, steady), ("latency", "p99", 0, wild)], CONFIDENCE, SAME_WITHIN)
    assert p50.smallest_ratio == seen_from(steady, 2)
    assert p99.smallest_ratio == seen_from(wild, 1)


def test_results_of_one_spread_see_alike():
    pairs = drawn_pairs(5, 0.05, seed=4)[:6]
    (sight,) = detectable_changes(
        [("latency", "p50", number, one) for number, one in enumerate(changes_of(pairs))], CONFIDENCE, SAME_WITHIN
    )
    assert sight.smallest_ratio < 1.1 * sight.least_ratio
