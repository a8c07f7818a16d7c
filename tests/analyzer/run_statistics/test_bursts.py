import numpy as np
import pytest
from drawn_series import autoregressive
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.run_statistics import bursts
from dds_trace.analyzer.run_statistics.bursts import (
    COSINES,
    cells_of,
    episode_sizes,
    equal_episodes,
    long_run_variance,
    positions_of,
    share_inflation,
    share_inflations,
)


def places(text):
    return np.flatnonzero(np.array(list(text)) == "x")


def test_a_cosine_is_seen_by_itself_alone():
    # x_t = cos(pi 3 (t + 1/2) / n): its projection is n / 2, all others are zero; (2 / n) (n / 2)^2 / COSINES.
    n = 600
    wave = np.cos(np.pi * 3 * (np.arange(n) + 0.5) / n)
    assert long_run_variance(wave) == pytest.approx(n / 2 / COSINES, rel=1e-9)
    assert long_run_variance(5 + wave) == pytest.approx(n / 2 / COSINES, rel=1e-9)


def test_long_series_are_added_up_in_cells():
    n = 100_000
    wave = np.cos(np.pi * 3 * (np.arange(n) + 0.5) / n)
    assert long_run_variance(wave + 7) == pytest.approx(n / 2 / COSINES, rel=1e-3)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.95])
def test_the_variance_of_a_mean_of_correlated_values(correlation):
    found = [long_run_variance(run) for run in autoregressive(200, 4000, correlation, seed=1)]
    # Each is chi-square with COSINES degrees: the mean of 200 has a relative error of sqrt(2 / 12 / 200) = 3 %.
    assert np.mean(found) == pytest.approx((1 + correlation) / (1 - correlation), rel=0.12)


def test_shares_of_independent_messages_are_not_inflated():
    draws = np.random.default_rng(2).random((300, 2000)) < 0.1
    found = [share_inflation(np.flatnonzero(draw), 2000) for draw in draws]
    assert np.mean(found) == pytest.approx(1.0, abs=0.07)


def test_shares_of_bursts_are_inflated_by_their_length():
    # 200 blocks of 20 that are wholly inside or outside: 20 messages count as one.
    draws = np.repeat(np.random.default_rng(3).random((300, 200)) < 0.1, 20, axis=1)
    found = [share_inflation(np.flatnonzero(draw), 4000) for draw in draws]
    assert np.mean(found) == pytest.approx(20, rel=0.1)


@pytest.mark.parametrize("marked", ["", "xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx", "x..x"])
def test_series_without_anything_to_compare_count_in_full(marked):
    assert share_inflation(places(marked), len(marked)) == 1.0


@pytest.mark.parametrize(
    "lengths", [(2000, 2000, 2000), (2000, 300, 2000, 300), (300, 300, 0, 1, 24, 300), (2000, 1500, 1024, 1023, 1023)]
)
def test_series_side_by_side_are_each_as_by_themselves(lengths):
    draw = np.random.default_rng(3)
    events = [np.flatnonzero(draw.random(n) < 0.2) for n in lengths]
    first = np.cumsum([0, *lengths])
    joined = np.concatenate([each + begin for each, begin in zip(events, first.tolist(), strict=False)])
    edges = np.cumsum([0, *map(len, events)])
    alone = [share_inflation(each, n) for each, n in zip(events, lengths, strict=True)]
    cells = cells_of(lengths)
    assert share_inflations(cells, cells.counts(joined), edges[None, :])[0] == pytest.approx(alone, rel=1e-12)


@pytest.mark.parametrize("lengths", [(5000,), (300, 0, 1, 2000)])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.9, 1.0])
def test_cells_count_few_and_many_messages_alike(monkeypatch, lengths, share):
    cells = cells_of(lengths)
    marked = np.flatnonzero(np.random.default_rng(4).random(sum(lengths)) < share)
    counts = []
    for many in (-1, np.inf):
        monkeypatch.setattr(bursts, "_MANY", many)
        counts += cells.counts(marked).tolist()
    ends = np.cumsum(cells.widths)
    assert (
        counts[0]
        == counts[1]
        == [((marked >= e - w) & (marked < e)).sum() for e, w in zip(ends, cells.widths, strict=True)]
    )


def test_an_episode_ends_at_a_gap():
    # 100 messages, 10 events: a mean distance of 10, so that only neighbours are together.
    line = "xxx......" + "x.x......" + "x" + "." * 40 + "xxxx"
    line += "." * (100 - len(line))
    assert episode_sizes(places(line), 100).tolist() == [3, 1, 1, 1, 4]
    # 1000 messages: a mean distance of 100, a gap of 5.
    assert episode_sizes(places(line), 1000).tolist() == [3, 2, 1, 4]
    assert episode_sizes(places(""), 100).tolist() == []


def test_positions_are_counted_in_mean_distances():
    assert positions_of(np.arange(3)).tolist() == [0.0, 1.0, 2.0]
    assert positions_of(np.arange(3), np.array([5, 10, 25])).tolist() == [0.0, 0.5, 2.0]
    assert positions_of(np.array([0, 2]), np.array([5, 10, 25])).tolist() == [0.0, 2.0]
    assert positions_of(np.arange(2), np.array([5, 7])).tolist() == [0.0, 1.0]
    assert positions_of(np.arange(2), np.array([5, 5])).tolist() == [0.0, 0.0]
    assert positions_of(np.arange(1), np.array([5])).tolist() == [0.0]


@given(marks=st.lists(st.booleans(), min_size=1, max_size=300))
def test_every_event_is_in_one_episode(marks):
    found = episode_sizes(np.flatnonzero(marks), len(marks))
    assert found.sum() == sum(marks)
    assert (found > 0).all()
    equal = equal_episodes(int(found.sum()), int(found @ found))
    assert (equal is None) if not sum(marks) else (1 <= equal <= len(found))


def test_unequal_episodes_are_worth_fewer():
    assert equal_episodes(4 + 4 + 4, 3 * 4**2) == 3
    assert equal_episodes(60 + 40 * 1, 60**2 + 40 * 1) == 3  # 100^2 / (3600 + 40) = 2.7
    assert equal_episodes(100, 100**2) == 1


def test_known_bursts_are_counted():
    generator = np.random.default_rng(4)
    for _ in range(20):
        slow = np.zeros(20_000, np.bool_)
        begins = 500 + np.arange(10) * 1_900 + generator.integers(0, 1_000, 10)
        for begin in begins:  # 20 messages of which every third is slow
            slow[begin : begin + 20 : 3] = True
        assert len(episode_sizes(np.flatnonzero(slow), 20_000)) == 10
