"""Bursts that are too few to tell of: drawn lines, counted by hand, and p99 of runs that hold one."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_series import autoregressive

from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.runs import Run, Statistic
from dds_trace.analyzer.run_statistics.tails import bursts_to_count, level_below

MESSAGES = 2000
SINGLES = np.arange(5, MESSAGES, 10)  # one message in ten, none beside another


def below_with(*rows: tuple[int, int]) -> np.ndarray:
    """The positions of the singles and of unbroken rows, each given as its first message and its length."""
    return np.unique(
        np.concatenate([SINGLES, *(first + np.arange(length) for first, length in rows)])
    ).astype(np.float64)


@pytest.mark.parametrize(
    ("quantile", "below"),
    [(0.99, 0.9), (0.999, 0.99), (0.95, 0.9), (0.9, None), (0.5, None), (0.01, 0.1), (0.1, None)],
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
    def with_row(length: int):
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
def test_one_burst_leaves_p99_open(length):
    """The messages of a short burst and forty quiet ones beyond p99 were counted as forty episodes."""
    for draw in np.random.default_rng(7).lognormal(0, 0.5, (10, 5000)):
        draw[2000 : 2000 + length] *= 20
        found = interval_of_runs([Run(draw)], Statistic(0.99))
        assert found.upper is None
        assert found.episodes < 10


def test_a_burst_is_one_in_spite_of_a_senders_jitter():
    generator = np.random.default_rng(8)
    draw = generator.lognormal(0, 0.5, 5000)
    draw[2000:2020] *= 20
    sent_ns = np.arange(5000) * 10_000_000 + generator.integers(-1_000_000, 1_000_000, 5000)
    assert interval_of_runs([Run(draw, sent_ns)], Statistic(0.99)).episodes == 1


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
def test_messages_without_bursts_keep_their_end(correlation):
    found = [
        interval_of_runs([Run(np.exp(run / 2))], Statistic(0.99))
        for run in autoregressive(100, 5000, correlation, seed=9)
    ]
    assert sum(interval.is_two_sided for interval in found) >= 97
