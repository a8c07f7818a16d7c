import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.runs import Levels, Run, Runs, Statistic, quantiles_of_runs
from dds_trace.analyzer.run_statistics.tails import (
    Tail,
    beyond_quantiles,
    bursts_to_count,
    episodes_of,
    inflations_of,
    level_below,
    limits_of,
    tails_of_all,
)


def tails_of(runs, quantile):
    (tails,) = tails_of_all([(Runs.of(runs), [quantile])])[0]
    return tails


def limit_alone(values, quantile):
    return limits_of([np.sort(values)], [quantile])[0, 0]


def is_beyond(values, limit, quantile):
    return values >= limit if quantile >= 0.5 or limit == math.inf else values <= limit


def test_the_tail_begins_at_an_order_statistic():
    values = np.random.default_rng(1).permutation(100)
    assert limit_alone(values, 0.9) == math.nextafter(89.0, math.inf)
    assert limit_alone(values, 0.1) == math.nextafter(10.0, -math.inf)


@given(
    groups=st.lists(st.lists(st.integers(1, 50) | st.just(math.inf), min_size=1, max_size=40), min_size=1, max_size=5),
    quantile=st.sampled_from([0.01, 0.1, 0.5, 0.9, 0.99]),
)
def test_a_group_has_the_limit_of_all_its_values(groups, quantile):
    runs = Runs(tuple(Run(np.array(values, np.float64)) for values in groups))
    levels = runs.levels
    relative = [levels.relative(run.values, level) for run, level in zip(runs, levels.values, strict=True)]
    (beyond,) = beyond_quantiles([runs], [quantile])
    limit = limit_alone(np.concatenate(relative), quantile)
    places = [is_beyond(values, limit, quantile).nonzero()[0].tolist() for values in relative]
    begins = np.cumsum([0, *map(len, groups)]).tolist()
    assert [part.tolist() for part in np.split(beyond.indices, beyond.offsets[1:-1])] == [
        [begin + place for place in of_run] for begin, of_run in zip(begins, places, strict=False)
    ]


@given(
    groups=st.lists(st.lists(st.integers(1, 50) | st.just(math.inf), min_size=1, max_size=60), min_size=1, max_size=4),
    quantiles=st.permutations([0.01, 0.1, 0.5, 0.9, 0.95, 0.99]),
)
def test_quantiles_together_give_the_same_as_one_by_one(groups, quantiles):
    def compared(beyond, tails):
        rows = [(tail.sizes.tolist(), tail.streaks, tail.bursts, tail.squares) for tail in tails]
        return (beyond.indices.tolist(), beyond.positions.tolist(), beyond.offsets.tolist()), rows

    runs = Runs(tuple(Run(np.array(values, np.float64)) for values in groups))
    beyond, tails = beyond_quantiles([runs], quantiles), tails_of_all([(runs, quantiles)])[0]
    inflations, values = inflations_of(runs, quantiles), quantiles_of_runs(runs, quantiles)
    for row, quantile in enumerate(quantiles):
        alone = tails_of(runs, quantile)
        assert compared(beyond[row], tails[row]) == compared(beyond_quantiles([runs], [quantile])[0], alone)
        assert [tail.inflation for tail in tails[row]] == pytest.approx([tail.inflation for tail in alone], rel=1e-9)
        assert inflations[row] == pytest.approx(inflations_of(runs, [quantile])[0], rel=1e-9)
        assert values[row].tolist() == quantiles_of_runs(runs, [quantile])[0].tolist()


@given(
    values=st.lists(st.integers(-5, 50) | st.just(math.inf), min_size=1, max_size=60),
    quantile=st.sampled_from([0.01, 0.1, 0.5, 0.9, 0.99]),
)
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
    assert is_beyond(values, limit_alone(values, quantile), quantile).sum() == messages


def test_beyond_what_is_all_the_same_lies_nothing():
    (tail,) = tails_of([Run(np.full(50, 7))], 0.9)
    assert (tail.messages, tail.inflation, episodes_of([tail])) == (0, 1.0, None)


def test_beyond_an_infinite_limit_are_the_lost():
    values = np.arange(1000.0)
    values[300:350] = math.inf
    assert limit_alone(values, 0.99) == math.inf
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
    # Chi-square of two degrees, 95 %: 5.99 / 2, times 3 runs / 3.
    assert episodes_of([tail_of(*[1] * 30), tail_of(), tail_of()]) == 3
    # 12, 10 and 8: variation 4 / 100, as many as 223 episodes would be likely, and 30 there are.
    assert episodes_of([tail_of(*[1] * 12), tail_of(*[1] * 10), tail_of(*[1] * 8)]) == 30
    assert episodes_of([tail_of(*[1] * 10)] * 3) == 30
    assert episodes_of([tail_of(*[1] * 30), tail_of()]) == 30  # two runs tell nothing of their spread


def test_episodes_of_unlike_sizes_are_worth_fewer():
    assert episodes_of([tail_of(9, 1, 1)]) == 1  # 11^2 / 83 = 1.46
    assert episodes_of([tail_of(4, 4, 4)]) == 3


def test_levels_that_are_not_positive_are_taken_off():
    assert Runs.of([Run(np.array([-2, -1, 0])), Run(np.array([4, 5, 6]))]).levels == Levels((-1, 5), is_ratio=False)
    assert Runs.of([Run(np.array([1, 2, 3])), Run(np.array([4, 5, 6]))]).levels == Levels((2, 5), is_ratio=True)
    assert Runs.of([Run(np.array([-1, 0, 1])), Run(np.array([4, 5, 6]))]).levels == Levels((0, 5), is_ratio=False)


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


MESSAGES = 2000
SINGLES = np.arange(5, MESSAGES, 10)  # one message in ten, none beside another


def below_with(*rows):
    """The positions of the singles and of unbroken rows, each given as its first message and its length."""
    return np.unique(np.concatenate([SINGLES, *(first + np.arange(length) for first, length in rows)])).astype(
        np.float64
    )


@pytest.mark.parametrize(
    ("quantile", "below"), [(0.99, 0.9), (0.999, 0.99), (0.95, 0.9), (0.9, None), (0.5, None), (0.01, 0.1), (0.1, None)]
)
def test_bursts_are_looked_for_where_ten_times_as_many_are_beyond(quantile, below):
    assert level_below(quantile) == (None if below is None else pytest.approx(below))


def test_rows_longer_than_chance_are_counted():
    # Two hundred rows, a share of one in ten: chance makes one of 5.3 in a hundred samples (0.1^4.3 = 0.01 / 200).
    below = below_with((300, 8), (1100, 12))
    assert bursts_to_count([below], [below[20:40]], MESSAGES) == 2
    assert bursts_to_count([below_with((301, 4))], [below[20:40]], MESSAGES) is None


def test_rows_may_have_gaps_where_few_messages_are_beyond():
    # One message in a hundred, gaps of four: a row goes on by 1 - 0.99^4 = 4 %, and chance makes one of 3.9 messages.
    def with_row(length):
        return np.union1d(np.arange(50.0, 10_000, 100), 5_001.0 + np.arange(length))

    found = [bursts_to_count([with_row(length)], [5_001.0 + np.arange(3)], 10_000) for length in (3, 4)]
    assert found == [None, 1]


def test_pieces_of_a_burst_are_one():
    # Two rows of eight with two fast messages between: nearer than a twentieth of the 1000 messages that a row has.
    in_burst = 301.0 + np.arange(8)
    assert bursts_to_count([below_with((301, 8), (311, 8))], [in_burst], MESSAGES) == 1
    assert bursts_to_count([below_with((301, 8), (901, 8))], [in_burst], MESSAGES) == 2


def test_bursts_of_all_runs_count_together():
    below = below_with((301, 8))
    runs = [below, below, SINGLES.astype(np.float64)]
    assert bursts_to_count(runs, [301.0 + np.arange(8), np.empty(0), np.empty(0)], 3 * MESSAGES) == 2


def test_nine_bursts_do_not_limit_a_tail():
    rows = [(101 + 200 * burst, 8) for burst in range(9)]
    assert bursts_to_count([below_with(*rows[:8])], [below_with(*rows[:8])], MESSAGES) == 8
    assert bursts_to_count([below_with(*rows)], [below_with(*rows)], MESSAGES) is None


def test_a_burst_that_holds_little_of_a_tail_does_not_decide_it():
    below = below_with((301, 8))
    in_burst, elsewhere = 301.0 + np.arange(2), np.arange(500.0, 2000.0, 50)
    assert bursts_to_count([below], [np.concatenate([in_burst, elsewhere[:18]])], MESSAGES) == 1
    assert bursts_to_count([below], [np.concatenate([in_burst, elsewhere])], MESSAGES) is None


def test_what_lies_between_bursts_is_in_none():
    # Two of 32 messages of a tail are in bursts, the others between the first burst and the second.
    below = below_with((301, 8), (1101, 8), (1501, 8))
    beyond = np.concatenate([[301.0, 302.0], np.arange(400.0, 1000.0, 20)])
    assert bursts_to_count([below], [beyond], MESSAGES) is None
    assert bursts_to_count([below], [beyond[:20]], MESSAGES) == 3


def test_rows_that_all_go_on_are_no_bursts():
    # Rows of two, three and six in turn: what would be a burst among singles is one of many here.
    rows = [(place, (2, 3, 6)[turn % 3]) for turn, place in enumerate(range(10, 1990, 40))]
    positions = np.concatenate([first + np.arange(length) for first, length in rows]).astype(np.float64)
    assert bursts_to_count([positions], [positions], MESSAGES) is None


def test_without_messages_beyond_there_is_nothing_to_count():
    assert bursts_to_count([np.empty(0)], [np.empty(0)], 100) is None
    assert bursts_to_count([np.arange(100.0)], [np.empty(0)], 100) is None


@pytest.mark.parametrize("length", [8, 12, 20, 60])
def test_one_burst_is_few_episodes(length):
    """The messages of a short burst and forty quiet ones beyond p99 were counted as forty episodes."""
    for draw in np.random.default_rng(7).lognormal(0, 0.5, (10, 5000)):
        draw[2000 : 2000 + length] *= 20
        found = interval_of_runs([Run(draw)], Statistic(0.99))
        assert found.episodes < 10


def test_a_burst_is_one_in_spite_of_a_senders_jitter():
    generator = np.random.default_rng(8)
    draw = generator.lognormal(0, 0.5, 5000)
    draw[2000:2020] *= 20
    sent_ns = np.arange(5000) * 10_000_000 + generator.integers(-1_000_000, 1_000_000, 5000)
    assert interval_of_runs([Run(draw, sent_ns)], Statistic(0.99)).episodes == 1
