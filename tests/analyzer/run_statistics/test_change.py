import math

import numpy as np
import pytest
from drawn_series import change_of_runs, log_normal_groups
from hypothesis import given
from hypothesis import strategies as st
from pinned import PINNED, assert_pinned

from dds_trace.analyzer.run_statistics.between_runs import estimates_of_runs, interval_of_runs
from dds_trace.analyzer.run_statistics.change import Change, Verdict, _change_within, least_variances
from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Statistic
from dds_trace.analyzer.statistics.distributions import student_quantile
from dds_trace.analyzer.statistics.intervals import Basis, Interval

P50, P99 = Statistic(0.5), Statistic(0.99)


def constant_runs(*levels):
    return [Run(np.full(100, level)) for level in levels]


def runs_of(group):
    return [Run(values) for values in group]


def test_three_runs_a_side_by_hand():
    # Logarithms 0, 1, 2 and 3, 4, 5: difference 3, error sqrt(2 / 3), four degrees, t 2.7764.
    base = constant_runs(1, math.e, math.e**2)
    new = constant_runs(math.e**3, math.e**4, math.e**5)
    change = change_of_runs(base, new, P50)
    reach = 2.776445 * math.sqrt(2 / 3)
    assert change.ratio == pytest.approx(math.e**3)
    assert change.ratio_low == pytest.approx(math.exp(3 - reach), rel=1e-5)
    assert change.ratio_high == pytest.approx(math.exp(3 + reach), rel=1e-5)
    assert change.difference == pytest.approx(math.e**4 - math.e)
    assert change.p_value == pytest.approx(0.0213, abs=1e-4)
    # 3.7611 standard errors are found in 80 of 100 (test_distributions).
    assert change.smallest_ratio == pytest.approx(math.exp(3.7610603 * math.sqrt(2 / 3)), rel=1e-6)
    assert change.verdict(0.05) is Verdict.WORSE
    assert change_of_runs(new, base, P50).verdict(0.05) is Verdict.BETTER


def test_the_ends_of_the_difference_by_hand():
    # Each side's own error 1 / sqrt(3), Welch's t 2.7764: ends of the logarithms 1 -+ 1.603 and 4 -+ 1.603.
    change = change_of_runs(constant_runs(1, math.e, math.e**2), constant_runs(math.e**3, math.e**4, math.e**5), P50)
    reach = 2.776445 / math.sqrt(3)
    base = [math.exp(1 + side * reach) for side in (0, -1, 1)]
    new = [math.exp(4 + side * reach) for side in (0, -1, 1)]
    low = new[0] - base[0] - math.hypot(new[0] - new[1], base[2] - base[0])
    high = new[0] - base[0] + math.hypot(new[2] - new[0], base[0] - base[1])
    assert change.difference_low == pytest.approx(low, rel=1e-5)
    assert change.difference_high == pytest.approx(high, rel=1e-5)


def test_of_many_groups_that_look_alike_none_is_quieter_than_their_mean():
    (one,) = estimates_of_runs(constant_runs(math.exp(-0.1), 1, math.exp(0.1)), [P50])
    assert least_variances([(one, one, None)] * 5).run == 0
    assert least_variances([(one, one, None)] * 6).run == pytest.approx(0.01)


def test_equal_runs_are_the_same():
    change = change_of_runs(constant_runs(100, 101, 99), constant_runs(100, 99, 101), P50)
    assert change.verdict(0.05) is Verdict.SAME
    assert change.verdict(0.001) is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("runs", [1, 2])
def test_fewer_than_three_runs_give_no_verdict(runs):
    group = log_normal_groups(1, 3, 1000, 0.0, seed=1)[0]
    change = change_of_runs(runs_of(group), runs_of(10 * group[:runs]), P50)
    assert change.basis is Basis.WITHIN_RUN
    assert change.verdict(0.05) is Verdict.INCONCLUSIVE
    assert change.ratio_low > 8
    assert change.difference_low > 0
    assert (change.p_value, change.smallest_ratio) == (None, None)


def test_within_a_run_an_open_end_leaves_the_ratio_open():
    values = np.random.default_rng(1).random(1000) + 1
    burst = values.copy()
    burst[100:120] += 10
    change = change_of_runs([Run(values)], [Run(burst)], P99)
    assert change.new.upper is None
    assert (change.ratio_low, change.ratio_high) == (None, None)
    assert change.ratio > 2


def test_passes_are_compared_one_by_one():
    # A drift of the machine that both sides share, and 10 % between them: without pairs it hides the difference.
    drift = np.array([1.0, 1.5, 2.0, 2.5, 3.0])
    noise = np.array([0.99, 1.01, 1.0, 1.005, 0.995])
    base, new = constant_runs(*drift), constant_runs(*(1.1 * drift * noise)[::-1])
    order = ([1, 2, 3, 4, 5], [5, 4, 3, 2, 1])
    paired = change_of_runs(base, new, P50, passes=order)
    assert (paired.pairs, paired.verdict(0.05)) == (5, Verdict.WORSE)
    logs = np.log(1.1 * noise)
    reach = student_quantile(0.975, 4) * logs.std(ddof=1) / math.sqrt(5)
    assert paired.ratio_low == pytest.approx(math.exp(logs.mean() - reach))
    assert change_of_runs(base, new, P50).verdict(0.05) is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("passes", [([1, 2, 3, 4, 5], [1, 2, 3, 4, 6]), ([1, 2, 3, 4, 5], [1, 2, 3, 4, 4])])
def test_passes_that_do_not_match_are_not_paired(passes):
    levels = (1.0, 1.1, 1.2, 1.3, 1.4)
    assert change_of_runs(constant_runs(*levels), constant_runs(*levels), P50, passes=passes).pairs == 0


def test_a_side_that_lost_every_message_is_infinitely_worse():
    alive, dead = constant_runs(1, 1.1, 0.9), constant_runs(*[math.inf] * 3)
    change = change_of_runs(alive, dead, P50)
    assert (change.ratio, change.ratio_low, change.ratio_high) == (math.inf, math.inf, math.inf)
    assert (change.difference_low, change.difference_high) == (math.inf, math.inf)
    assert change.verdict(0.05) is Verdict.WORSE
    assert change_of_runs(dead, alive, P50).verdict(0.05) is Verdict.BETTER
    both = change_of_runs(dead, dead, P50)
    assert (both.ratio, both.verdict(0.05)) == (None, Verdict.INCONCLUSIVE)


def test_a_survivors_tail_is_no_improvement():
    # The new side loses exactly the 5 % slowest: their p99 would be far better, with the losses it is infinite.
    base = log_normal_groups(1, 5, 2000, 0.02, seed=2)[0]
    limits = np.quantile(base, 0.95, axis=1, keepdims=True)
    new = np.where(base > limits, math.inf, base)
    change = change_of_runs(runs_of(base), runs_of(new), P99)
    assert change.verdict(0.05) is Verdict.WORSE
    assert change_of_runs(runs_of(base), runs_of(new), P50).ratio == pytest.approx(1)


def test_one_lost_run_of_five_is_no_proof():
    base = constant_runs(1, 1.01, 0.99, 1.02, 0.98)
    change = change_of_runs(base, constant_runs(1, 1.01, 0.99, 1.02, math.inf), P50)
    assert change.verdict(0.05) is Verdict.INCONCLUSIVE
    assert change.ratio_low < 1
    assert change.ratio_high > 10


def test_the_ratio_beside_lost_runs_is_that_of_mean_reciprocals():
    # (1 + 1/2 + 0) / 3 over 1/4.
    assert change_of_runs(constant_runs(1, 2, math.inf), constant_runs(4, 4, 4), P50).ratio == 2.0


def test_times_below_zero_have_a_difference_and_no_ratio():
    change = change_of_runs(constant_runs(-1, 0, 1), constant_runs(9, 10, 11), MEAN)
    assert change.difference == 10
    assert change.difference_low == pytest.approx(10 - 2.776445 * math.sqrt(2 / 3), rel=1e-5)
    assert change.difference_high == pytest.approx(10 + 2.776445 * math.sqrt(2 / 3), rel=1e-5)
    assert (change.ratio, change.verdict(0.05)) == (None, Verdict.INCONCLUSIVE)


def test_sides_without_messages_are_not_compared():
    change = change_of_runs([], constant_runs(1, 2, 3), P50)
    assert (change.difference, change.ratio, change.basis) == (None, None, Basis.WITHIN_RUN)


@given(
    base=st.lists(st.floats(0.1, 100) | st.just(math.inf), min_size=3, max_size=6),
    new=st.lists(st.floats(0.1, 100), min_size=3, max_size=6),
)
def test_sides_can_be_exchanged(base, new):
    one = change_of_runs(constant_runs(*base), constant_runs(*new), P50)
    other = change_of_runs(constant_runs(*new), constant_runs(*base), P50)
    exchanged = {Verdict.BETTER: Verdict.WORSE, Verdict.WORSE: Verdict.BETTER}
    verdict = one.verdict(0.0)
    assert other.verdict(0.0) is exchanged.get(verdict, verdict)
    assert one.p_value == pytest.approx(other.p_value)
    if math.inf not in base:
        assert one.ratio_low == pytest.approx(1 / other.ratio_high)
        assert one.difference_high == pytest.approx(-other.difference_low)


@pytest.mark.parametrize("spread", [0.0, 0.05, 0.10])
@pytest.mark.parametrize("runs", [3, 5])
def test_equal_sides_are_rarely_told_apart(spread, runs):
    groups = log_normal_groups(600, runs, 300, spread, seed=3)
    pairs = zip(groups[::2], groups[1::2], strict=True)
    changes = [change_of_runs(runs_of(base), runs_of(new), P50) for base, new in pairs]
    false = np.mean([change.verdict(0.0) is not Verdict.INCONCLUSIVE for change in changes])
    assert false <= 0.07
    assert np.mean([change.ratio_low > 1.1 for change in changes]) <= 0.03


def test_equal_sides_measured_in_passes_are_rarely_told_apart():
    groups = log_normal_groups(600, 5, 300, 0.05, seed=4)
    order = (range(5), range(5))
    pairs = zip(groups[::2], groups[1::2], strict=True)
    changes = [change_of_runs(runs_of(base), runs_of(new), P50, passes=order) for base, new in pairs]
    assert np.mean([change.verdict(0.0) is not Verdict.INCONCLUSIVE for change in changes]) <= 0.07


@pytest.mark.parametrize("statistic", [P50, P99])
def test_twenty_percent_are_found_with_five_runs_of_1000_a_side(statistic):
    groups = log_normal_groups(200, 5, 1000, 0.05, seed=5)
    pairs = zip(groups[::2], 1.2 * groups[1::2], strict=True)
    verdicts = [change_of_runs(runs_of(base), runs_of(new), statistic).verdict(0.05) for base, new in pairs]
    assert np.mean([verdict is Verdict.WORSE for verdict in verdicts]) >= 0.8


def test_the_smallest_ratio_is_found_in_80_of_100():
    groups = log_normal_groups(800, 5, 300, 0.05, seed=6)
    pairs = list(zip(groups[::2], groups[1::2], strict=True))
    smallest = np.mean([change_of_runs(runs_of(base), runs_of(new), P50).smallest_ratio for base, new in pairs])
    found = [change_of_runs(runs_of(base), runs_of(smallest * new), P50).ratio_low > 1 for base, new in pairs]
    assert np.mean(found) == pytest.approx(0.8, abs=0.06)


@pytest.mark.parametrize(
    ("ends", "verdict"),
    [
        ((0.9, 1.1), Verdict.SAME),  # on the edges of the tolerance
        ((0.899, 1.1), Verdict.INCONCLUSIVE),
        ((0.9, 1.101), Verdict.INCONCLUSIVE),
        ((0.8, 0.999), Verdict.BETTER),
        ((0.8, 1.0), Verdict.INCONCLUSIVE),
        ((1.001, 1.2), Verdict.WORSE),
        ((1.0, 1.2), Verdict.INCONCLUSIVE),
        ((None, 0.5), Verdict.INCONCLUSIVE),
        ((2.0, None), Verdict.INCONCLUSIVE),
    ],
)
def test_a_verdict_begins_where_its_interval_ends(ends, verdict):
    side = interval_of_runs(constant_runs(1.0, 1.0, 1.0), P50)
    assert Change(side, side, Basis.BETWEEN_RUNS, ratio_low=ends[0], ratio_high=ends[1]).verdict(0.1) is verdict
    within = Change(side, side, Basis.WITHIN_RUN, ratio_low=ends[0], ratio_high=ends[1])
    assert within.verdict(0.1) is Verdict.INCONCLUSIVE


def side(value, lower, upper, basis=Basis.WITHIN_RUN):
    return Interval(value, lower, upper, 0.95, 100, 100, basis, 1, 0, None)


def test_two_intervals_within_runs_are_put_together():
    # 10 (8 to 14) and 20 (16 to 25): 10 - hypot(4, 4), 10 + hypot(5, 2); 2 times and through hypot of the logarithms.
    change = _change_within(side(10.0, 8.0, 14.0), side(20.0, 16.0, 25.0))
    assert (change.difference, change.ratio, change.basis) == (10, 2, Basis.WITHIN_RUN)
    assert (change.difference_low, change.difference_high) == pytest.approx((10 - math.sqrt(32), 10 + math.sqrt(29)))
    low = math.log(2) - math.hypot(math.log(20 / 16), math.log(14 / 10))
    high = math.log(2) + math.hypot(math.log(25 / 20), math.log(10 / 8))
    assert (change.ratio_low, change.ratio_high) == pytest.approx((math.exp(low), math.exp(high)))
    touching = _change_within(
        side(0.5, 0.0, 14.0), side(20.0, 16.0, 25.0)
    )  # no logarithm of zero, but a ratio of the values
    assert (touching.ratio, touching.ratio_low, touching.ratio_high) == (40, None, None)
    assert touching.difference_low == pytest.approx(19.5 - math.hypot(4, 13.5))
    small = _change_within(side(0.5, 0.25, 0.75), side(0.5, 0.25, 0.75))
    assert small.ratio_low == pytest.approx(math.exp(-math.hypot(math.log(2), math.log(1.5))))


@pytest.mark.parametrize(
    ("base", "new", "difference", "ratio"),
    [
        ((None, None, None), (2.0, 1.0, 3.0), None, None),
        ((2.0, 1.0, 3.0), (None, None, None), None, None),
        ((0.0, -1.0, 1.0), (2.0, 1.0, 3.0), 2.0, None),
        ((2.0, 1.0, 3.0), (0.0, -1.0, 1.0), -2.0, None),
        ((math.inf, 1.0, math.inf), (2.0, 1.0, 3.0), -math.inf, None),
        ((2.0, 1.0, 3.0), (math.inf, 1.0, math.inf), math.inf, math.inf),
        ((math.inf, 1.0, math.inf), (math.inf, 1.0, math.inf), None, None),
    ],
)
def test_what_is_unknown_or_infinite_has_no_ends(base, new, difference, ratio):
    change = _change_within(side(*base), side(*new))
    assert (change.difference, change.ratio) == (difference, ratio)
    if None in base + new or math.inf in base + new:
        assert (change.difference_low, change.difference_high) == (None, None)


@pytest.mark.parametrize("name", PINNED["statistics"])
def test_every_statistic_says_of_drawn_campaigns_what_it_said(name):
    assert_pinned("statistics", name)


@pytest.mark.parametrize("name", PINNED["series"])
def test_every_detector_says_of_drawn_series_what_it_said(name):
    assert_pinned("series", name)
