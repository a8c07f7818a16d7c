import importlib
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.bursts import COSINES, share_inflation
from dds_trace.analyzer.run_statistics.change import Verdict
from dds_trace.analyzer.run_statistics.received import (
    DeliveryChange,
    LossExcess,
    change_of_received,
    late_share,
    received_interval,
    wilson_ends,
)
from dds_trace.analyzer.run_statistics.runs import Run, Runs
from dds_trace.analyzer.statistics.distributions import student_cdf, student_quantile
from dds_trace.analyzer.statistics.intervals import Basis, Interval
from dds_trace.analyzer.statistics.power import smallest_shift


def losing(messages, *lost):
    received = np.ones(messages, np.bool_)
    for first, end in lost:
        received[first:end] = False
    return received


def test_nothing_lost_is_garwoods_limit():
    found = received_interval([losing(1000)] * 3)
    assert (found.value, found.upper, found.episodes) == (1.0, 1.0, 0)
    assert found.lower == pytest.approx(1 - 3.68888 / 3000, abs=1e-8)
    assert found.basis is Basis.BETWEEN_RUNS


@pytest.mark.parametrize(
    ("p", "adjusted", "sure"),
    [(0.25, 0.5, True), (0.26, 0.01, False), (0.01, 0.51, False), (None, 0.01, False), (0.01, None, False)],
)
def test_more_than_a_share_is_lost_for_sure_by_half_of_the_error_and_by_all_of_it_among_many(p, adjusted, sure):
    assert LossExcess(5, 1000, 0.01, 0.02, p_value=p, p_adjusted=adjusted).is_sure(0.5) is sure


def test_one_outage_is_one_event():
    # Garwood of one: 0.02532 to 5.5716 episodes; of 30 messages each below, of 2 * 30 - 1 above.
    found = received_interval([losing(5000, (700, 730))])
    assert (found.value, found.episodes, found.basis) == (0.994, 1, Basis.WITHIN_RUN)
    assert found.upper == pytest.approx(1 - 0.0253178 * 30 / 5000, abs=1e-7)
    assert found.lower == pytest.approx(1 - 5.5716434 * 59 / 5000, abs=1e-7)


def test_unlike_outages_count_by_the_message():
    # Sizes 1 and 99: a lost message is in an outage of (1 + 99^2) / 100 = 98.02 on average; 2 mean - 1 is 99.
    found = received_interval([losing(5000, (100, 101), (700, 799))])
    assert found.lower == pytest.approx(1 - 7.2246877 * 99 / 5000, abs=1e-7)


def test_what_is_rarer_is_counted():
    silent = received_interval([~losing(1000)])
    assert (silent.value, silent.lower) == (0.0, 0.0)
    assert silent.upper == pytest.approx(3.68888 / 1000, abs=1e-8)
    few = received_interval([~losing(5000, (700, 730))])
    assert (few.value, few.episodes) == (0.006, 1)


def test_without_messages_there_is_no_ratio():
    found = received_interval([])
    assert found == Interval(None, None, None, 0.95, 0, 0, Basis.WITHIN_RUN, 0, 0, None)
    assert received_interval([np.empty(0, np.bool_)]) == replace(found, runs=1)


def test_ends_of_a_few_messages_are_cut():
    one = received_interval([losing(1)])
    assert (one.lower, one.upper, one.independent) == (0.0, 1.0, 1)
    assert received_interval([losing(7, (2, 5))]).lower == 0.0  # 5.57 outages of five messages are more than seven


def test_from_ten_episodes_on_the_share_is_normal():
    places = np.arange(40, 1000, 100)
    nine, ten = (losing(1000, *((place, place + 1) for place in places[:count])) for count in (9, 10))
    assert received_interval([nine]).lower == pytest.approx(1 - 17.0848 / 1000, abs=1e-7)  # Garwood's of nine
    independent = 1000 / max(share_inflation(places, 1000), 0.25)
    low, high = wilson_ends(0.01, independent, student_quantile(0.975, COSINES))
    found = received_interval([ten])
    assert (found.episodes, found.lower, found.upper) == (10, pytest.approx(1 - high), pytest.approx(1 - low))


def test_no_share_is_below_none_or_above_all():
    assert wilson_ends(0.0, 9, 2.1)[0] == 0.0  # -2e-17 by its arithmetic
    assert wilson_ends(1.0, 9, 2.0)[1] == 1.0  # 1 + 2e-16


def test_wilson_by_hand():
    # 5 of 10: centre 1/2, reach 1.96 sqrt(0.025 + 0.0096) / 1.384 = 0.2634.
    assert wilson_ends(0.5, 10, 1.959964) == (pytest.approx(0.2366, abs=1e-4), pytest.approx(0.7634, abs=1e-4))


def test_runs_that_lose_unlike_shares_widen():
    generator = np.random.default_rng(1)
    alike = [generator.random(2000) > 0.05 for _ in range(5)]
    unlike = [generator.random(2000) > share for share in (0.01, 0.03, 0.05, 0.07, 0.09)]
    widths = [found.upper - found.lower for found in map(received_interval, (alike, unlike))]
    assert widths[1] > 2.5 * widths[0]
    # By hand: shares 1 ... 9 %, deviation 3.16 %, / sqrt(5) * 2.776 = 3.9 % to either side.
    assert widths[1] == pytest.approx(2 * 0.039, rel=0.15)


@pytest.mark.parametrize("runs", [1, 3, 5])
def test_nineteen_of_twenty_hold_single_losses(runs):
    draws = np.random.default_rng(2).random((400, runs, 1000)) > 0.03
    found = [received_interval(list(group)) for group in draws]
    assert 0.92 <= np.mean([i.lower <= 0.97 <= i.upper for i in found]) <= 0.995


@pytest.mark.parametrize("runs", [1, 3, 5, 10])
def test_most_hold_outages(runs):
    # Outages of 20 begin at any message with 1 in 1000: 2 % are lost, at first in two outages a run.
    generator, held, seen = np.random.default_rng(3), 0, 0
    for _ in range(300):
        group = []
        for begins in generator.random((runs, 1019)) < 0.001:
            lost = np.convolve(begins, np.ones(20))[19:1019] > 0
            group.append(~lost)
        found = received_interval(group)
        if found.episodes:
            seen += 1
            held += found.lower <= 0.999**20 <= found.upper
    assert held / seen >= 0.85


@given(
    group=st.lists(st.lists(st.booleans(), min_size=1, max_size=80), min_size=1, max_size=6),
    confidence=st.sampled_from([0.8, 0.95, 0.99]),
)
def test_ends_lie_between_none_and_all(group, confidence):
    runs = [np.array(run) for run in group]
    found = received_interval(runs, confidence)
    assert 0 <= found.lower <= found.value + 1e-12
    assert found.value - 1e-12 <= found.upper <= 1
    mirrored = received_interval([~run for run in runs], confidence)
    if not math.isclose(found.value, 0.5):
        assert mirrored.lower == pytest.approx(1 - found.upper, abs=1e-12)


def test_a_side_that_loses_more_is_worse():
    generator = np.random.default_rng(4)
    base = [generator.random(2000) > 0.001 for _ in range(5)]
    new = [generator.random(2000) > 0.03 for _ in range(5)]
    change = change_of_received(base, new)
    assert change.difference == pytest.approx(-0.029, abs=0.005)
    assert change.difference_high < 0
    assert change.verdict() is Verdict.WORSE
    assert change_of_received(new, base).verdict() is Verdict.BETTER
    assert change_of_received(base[:2], new).verdict() is Verdict.INCONCLUSIVE
    assert change_of_received(base, base).verdict(same_within=0.01) is Verdict.SAME
    assert change_of_received(base, []).difference is None


def test_equal_losses_are_rarely_told_apart():
    draws = np.random.default_rng(5).random((300, 2, 5, 500)) > 0.02
    verdicts = [change_of_received(list(base), list(new)).verdict() for base, new in draws]
    assert np.mean([verdict is not Verdict.INCONCLUSIVE for verdict in verdicts]) <= 0.07


@pytest.mark.parametrize("length", [8, 20, 40, 100])
def test_one_outage_in_one_run_of_five_is_no_verdict(length):
    base = [losing(400)] * 5
    change = change_of_received(base, [*base[1:], losing(400, (100, 100 + length))])
    assert change.verdict() is Verdict.INCONCLUSIVE
    assert change.difference_low < 0 < change.difference_high
    assert change.p_value > 0.3
    # The mean angle is a fifth of the run's, and so is its error; each run has at least the variance of outages half as long.
    angle = math.asin(math.sqrt(length / 400)) / 5
    least = 0.025 * math.sqrt(length / 2)
    assert change.p_value == pytest.approx(
        2 * student_cdf(-angle / math.hypot(max(angle, least / math.sqrt(5)), least / math.sqrt(5)), change.degrees)
    )


@pytest.mark.parametrize(("runs", "messages"), [((5, 5), (400, 400)), ((3, 10), (400, 400)), ((5, 5), (200, 1000))])
@pytest.mark.parametrize("together", [1, 20, 100])
def test_equal_sides_with_outages_are_rarely_told_apart(together, runs, messages):
    generator = np.random.default_rng(6)

    def draw(number, count):  # 5 % are lost, in outages that begin at any message
        begins = generator.random((number, count + together)) < 0.05 / together
        return [~(np.convolve(one, np.ones(together))[together : together + count] > 0) for one in begins]

    changes = [change_of_received(*map(draw, runs, messages)) for _ in range(300)]
    assert np.mean([change.verdict() is not Verdict.INCONCLUSIVE for change in changes]) <= 0.07


def test_a_drop_that_could_not_be_seen_is_none():
    unlike = [losing(100, (0, lost)) for lost in (5, 50, 95)]
    assert change_of_received(unlike, unlike).smallest_drop is None


@pytest.mark.parametrize(
    ("ends", "verdict"),
    [
        ((-0.1, 0.1), Verdict.SAME),  # on the edges of the tolerance
        ((-0.101, 0.1), Verdict.INCONCLUSIVE),
        ((-0.1, 0.101), Verdict.INCONCLUSIVE),
        ((-0.5, -0.001), Verdict.WORSE),
        ((-0.5, 0.0), Verdict.INCONCLUSIVE),
        ((0.001, 0.5), Verdict.BETTER),
        ((0.0, 0.5), Verdict.INCONCLUSIVE),
        ((None, -0.5), Verdict.INCONCLUSIVE),
        ((0.5, None), Verdict.INCONCLUSIVE),
    ],
)
def test_a_verdict_begins_where_its_interval_ends(ends, verdict):
    side = received_interval([losing(100)] * 3)
    assert DeliveryChange(side, side, Basis.BETWEEN_RUNS, 0.0, *ends).verdict(0.1) is verdict
    assert DeliveryChange(side, side, Basis.WITHIN_RUN, 0.0, *ends).verdict(0.1) is Verdict.INCONCLUSIVE
    assert DeliveryChange(side, side, Basis.BETWEEN_RUNS, 0.0, 0.0, 0.0).verdict() is Verdict.SAME
    assert DeliveryChange(side, side, Basis.BETWEEN_RUNS, 0.2, 0.1, 0.3, p_value=0.06).verdict() is Verdict.INCONCLUSIVE


def test_the_ends_of_a_change_are_those_of_its_sides():
    base, new = (
        [losing(400, (at, at + 2)) for at in (10, 60, 200)],
        [losing(400, (at, at + 9)) for at in (9, 80, 300, 310)],
    )
    change = change_of_received(base, new, 0.9)
    one, other = received_interval(base, 0.9), received_interval(new, 0.9)
    assert (change.base, change.new, change.basis) == (one, other, Basis.BETWEEN_RUNS)
    assert change.difference == other.value - one.value == pytest.approx(-7 / 400)
    # The lower of Newcombe's ends is the farther one, the upper one that of the test.
    low = change.difference - math.hypot(other.value - other.lower, one.upper - one.value)
    high = change.difference + math.hypot(other.upper - other.value, one.value - one.lower)
    assert change.difference_low == pytest.approx(low)
    assert 0 < high < change.difference_high
    # No spread: each run has the variance of outages of half the mean of 6, 3 / 1600; two degrees, as the side with fewer runs has.
    angles = [math.asin(math.sqrt(lost / 400)) for lost in (2, 9)]
    errors = [math.sqrt(3) / 40 / math.sqrt(runs) for runs in (3, 4)]
    error = math.hypot(*errors)
    assert change.p_value == pytest.approx(2 * student_cdf(-(angles[1] - angles[0]) / error, 2))
    farthest = angles[0] + smallest_shift(error, 2, 0.9)
    assert change.smallest_drop == pytest.approx(math.sin(farthest) ** 2 - math.sin(angles[0]) ** 2)
    single = change_of_received(base[:2], new)
    assert (single.basis, single.smallest_drop) == (Basis.WITHIN_RUN, None)
    assert change_of_received([], new).difference_low is None


MS = 1e6


def runs_at(levels, messages=300, seed=0):
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
    assert share.upper_of_seen < 1e-3
    # A burst of 4.5 may not have come: Poisson's limit of one is 6.0469 of them.
    assert share.upper == pytest.approx(4.5 * 6.046938 / 1500, rel=1e-5)


@pytest.mark.parametrize(
    ("late", "upper"), [([0], 6.046938 * 2.75), ([0, 1], 6.046938 * 3.25), ([0, 100, 200], 9.340106 * 1.875)]
)
def test_what_is_late_in_few_bursts_may_come_in_another_one(late, upper):
    times = np.full((10, 300), MS)
    times[0, late] = np.inf
    assert late_share(Runs.of([Run(one) for one in times]), 2 * MS).upper == pytest.approx(upper / 3000, rel=1e-5)


@pytest.mark.parametrize(("runs", "burst"), [(3, 15), (3, 30), (5, 30), (20, 15), (20, 30)])
def test_few_settings_that_lose_2_percent_in_bursts_are_within_1_percent(runs, burst):
    """54 to 8 of 100 were."""
    assert said_to_meet(runs, burst, 0.02, 60)[0] <= 6


@pytest.mark.parametrize("runs", [10, 20])
def test_settings_that_lose_hardly_any_are_found_with_as_many_runs_as_before(runs):
    assert said_to_meet(runs, 1, 0.001, 30)[0] == 30
    assert late_share(runs_at([1] * runs), 3 * MS).upper <= 0.01
    assert said_to_meet(runs, 5, 0.001, 60)[0] >= 45  # 52a32e47: 55 and 58


def said_to_meet(runs, burst, share, campaigns):
    sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))
    count = importlib.import_module("coverage_kinds").count_bursts
    sys.path.pop()
    return count(np.random.default_rng([runs, burst]), runs, burst, share, campaigns)


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
