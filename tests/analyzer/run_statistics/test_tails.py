"""Tails of groups: thresholds with ties and losses, levels of runs set aside."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.runs import Levels, Run, Runs, quantiles_of_runs
from dds_trace.analyzer.run_statistics.tails import (
    Tail,
    Threshold,
    beyond_quantiles,
    episodes_of,
    inflations_of,
    thresholds_of,
)
from dds_trace.analyzer.run_statistics.tails import tails_of as tails_of_quantiles


def tails_of(runs, quantile):
    (tails,) = tails_of_quantiles(Runs.of(runs), [quantile])
    return tails


def threshold_alone(values, quantile):
    (threshold,) = thresholds_of(np.sort(values), [quantile])
    return threshold


def test_the_tail_begins_at_an_order_statistic():
    values = np.random.default_rng(1).permutation(100)
    assert threshold_alone(values, 0.9) == Threshold(89.0, is_upper=True, is_part=False)
    assert threshold_alone(values, 0.1) == Threshold(10.0, is_upper=False, is_part=False)


@given(
    groups=st.lists(
        st.lists(st.integers(1, 50) | st.just(math.inf), min_size=1, max_size=40), min_size=1, max_size=5
    ),
    quantile=st.sampled_from([0.01, 0.1, 0.5, 0.9, 0.99]),
)
@settings(deadline=None)
def test_a_group_has_the_threshold_of_all_its_values(groups, quantile):
    runs = Runs(tuple(Run(np.array(values, np.float64)) for values in groups))
    levels = runs.levels
    relative = [levels.relative(run.values, level) for run, level in zip(runs, levels.values, strict=True)]
    (beyond,) = beyond_quantiles(runs, [quantile])
    threshold = threshold_alone(np.concatenate(relative), quantile)
    places = [threshold.is_beyond(values).nonzero()[0].tolist() for values in relative]
    begins = np.cumsum([0, *map(len, groups)]).tolist()
    assert [part.tolist() for part in np.split(beyond.indices, beyond.offsets[1:-1])] == [
        [begin + place for place in of_run] for begin, of_run in zip(begins, places, strict=False)
    ]


@given(
    groups=st.lists(
        st.lists(st.integers(1, 50) | st.just(math.inf), min_size=1, max_size=60), min_size=1, max_size=4
    ),
    quantiles=st.permutations([0.01, 0.1, 0.5, 0.9, 0.95, 0.99]),
)
@settings(deadline=None)
def test_quantiles_together_give_the_same_as_one_by_one(groups, quantiles):
    """Tails within wider ones, with ties and losses, in whatever order."""

    def compared(beyond, tails):
        rows = [(tail.sizes.tolist(), tail.streaks, tail.bursts, tail.squares) for tail in tails]
        return (beyond.indices.tolist(), beyond.positions.tolist(), beyond.offsets.tolist()), rows

    runs = Runs(tuple(Run(np.array(values, np.float64)) for values in groups))
    beyond, tails = beyond_quantiles(runs, quantiles), tails_of_quantiles(runs, quantiles)
    inflations, values = inflations_of(runs, quantiles), quantiles_of_runs(runs, quantiles)
    for row, quantile in enumerate(quantiles):
        alone = tails_of(runs, quantile)
        assert compared(beyond[row], tails[row]) == compared(beyond_quantiles(runs, [quantile])[0], alone)
        assert [tail.inflation for tail in tails[row]] == pytest.approx(
            [tail.inflation for tail in alone], rel=1e-9
        )
        assert inflations[row] == pytest.approx(inflations_of(runs, [quantile])[0], rel=1e-9)
        assert values[row].tolist() == quantiles_of_runs(runs, [quantile])[0].tolist()


@given(
    values=st.lists(st.integers(-5, 50) | st.just(math.inf), min_size=1, max_size=60),
    quantile=st.sampled_from([0.01, 0.1, 0.5, 0.9, 0.99]),
)
@settings(deadline=None)
def test_one_run_alone_has_the_same_inflation_either_way(values, quantile):
    run, other = Run(np.array(values, np.float64)), Run(np.arange(50.0))
    (tail,) = tails_of([run], quantile)
    ((alone,),) = inflations_of(Runs((run,)), [quantile])
    ((beside, _),) = inflations_of(Runs((run, other)), [quantile])
    assert alone == tail.inflation == pytest.approx(beside, rel=1e-12)


@pytest.mark.parametrize(("quantile", "messages"), [(0.9, 10), (0.99, 10), (0.5, 10), (0.2, 90), (0.05, 90)])
def test_equal_values_are_part_of_the_tail_if_that_fits_better(quantile, messages):
    # Ninety 1 and ten 2. p90 is 1, and 2 lies beyond; p99 is 2, and nothing else does; p20 and p5 are 1.
    values = np.array([1] * 90 + [2] * 10)
    assert threshold_alone(values, quantile).is_beyond(values).sum() == messages


def test_beyond_what_is_all_the_same_lies_nothing():
    (tail,) = tails_of([Run(np.full(50, 7))], 0.9)
    assert (tail.messages, tail.inflation, episodes_of([tail])) == (0, 1.0, None)


def test_beyond_an_infinite_threshold_are_the_lost():
    values = np.arange(1000.0)
    values[300:350] = math.inf
    assert threshold_alone(values, 0.99) == Threshold(math.inf, is_upper=True, is_part=False)
    (tail,) = tails_of([Run(values)], 0.99)
    assert (tail.messages, tail.sizes.tolist()) == (50, [50])
    assert tail.inflation > 10


def test_a_run_without_a_burst_has_no_episode():
    quiet, loud = (Run(draw + 1) for draw in np.random.default_rng(1).random((2, 1000)))
    loud.values[[100, 101, 102, 103, 500, 501, 502, 503]] = 50.0
    tails = tails_of([quiet, loud], 0.996)
    assert [tail.sizes.tolist() for tail in tails] == [[], [4, 4]]
    assert episodes_of(tails) == 2


def test_a_run_that_is_slower_throughout_is_no_episode():
    generator = np.random.default_rng(2)
    runs = [Run(level * (1 + 0.1 * generator.random(1000))) for level in (1.0, 2.0, 3.0)]
    assert [tail.messages for tail in tails_of(runs, 0.5)] == [500, 500, 500]
    assert episodes_of(tails_of(runs, 0.99)) > 20


def tail_of(*sizes):
    return Tail(sum(sizes), np.array(sizes, np.int64), 1.0, sum(size**2 for size in sizes))


def test_runs_without_an_episode_limit_the_number():
    # Thirty single messages in one of three runs: mean 10, variance 300, variation 3.
    # Chi-square of two degrees, 95 %: 5.99 / 2 (2.97 by the cube), times 3 runs / 3.
    assert episodes_of([tail_of(*[1] * 30), tail_of(), tail_of()]) == 3
    # 12, 10 and 8: variation 4 / 100, as many as 223 episodes would be likely, and 30 there are.
    assert episodes_of([tail_of(*[1] * 12), tail_of(*[1] * 10), tail_of(*[1] * 8)]) == 30
    assert episodes_of([tail_of(*[1] * 10)] * 3) == 30
    assert episodes_of([tail_of(*[1] * 30), tail_of()]) == 30  # two runs tell nothing of their spread


def test_episodes_of_unlike_sizes_are_worth_fewer():
    assert episodes_of([tail_of(9, 1, 1)]) == 1  # 11^2 / 83 = 1.46
    assert episodes_of([tail_of(4, 4, 4)]) == 3


def test_levels_that_are_not_positive_are_taken_off():
    assert Runs.of([Run(np.array([-2, -1, 0])), Run(np.array([4, 5, 6]))]).levels == Levels(
        (-1, 5), is_ratio=False
    )
    assert Runs.of([Run(np.array([1, 2, 3])), Run(np.array([4, 5, 6]))]).levels == Levels(
        (2, 5), is_ratio=True
    )
    assert Runs.of([Run(np.array([-1, 0, 1])), Run(np.array([4, 5, 6]))]).levels == Levels(
        (0, 5), is_ratio=False
    )


def test_a_run_that_lost_most_is_given_the_level_of_the_others():
    runs = [Run(np.array([2.0, math.inf, math.inf])), Run(np.array([3.0, 4.0, 5.0]))]
    assert Runs.of(runs).levels == Levels((4, 4), is_ratio=True)
    assert Runs.of([Run(np.full(3, math.inf))] * 2).levels == Levels((0, 0), is_ratio=False)


def test_a_pause_of_the_sender_ends_an_episode():
    values = np.ones(200)
    values[[50, 51, 52, 53]] = 9
    evenly_ns = np.arange(200) * 1_000_000
    paused_ns = evenly_ns + np.where(np.arange(200) > 51, 60_000_000_000, 0)
    assert [tail.sizes.tolist() for tail in tails_of([Run(values, evenly_ns)], 0.98)] == [[4]]
    assert [tail.sizes.tolist() for tail in tails_of([Run(values, paused_ns)], 0.98)] == [[2, 2]]
