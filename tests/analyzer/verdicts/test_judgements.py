import numpy as np
import pytest

from dds_trace.analyzer.run_statistics.received import loss_excesses
from dds_trace.analyzer.run_statistics.setups import RunLogarithms, campaign_variance, passes_depend, setup_means

CHANCE = np.random.default_rng(2).standard_normal((24, 5))


def runs_losing(*counts, messages=1000):
    return [np.arange(messages) % (messages // count) != 1 if count else np.ones(messages, bool) for count in counts]


@pytest.mark.parametrize(
    ("runs", "is_sure"),
    [
        pytest.param(runs_losing(25, 40, 25), True, id="three percent of three runs"),
        pytest.param(runs_losing(25, 40), False, id="two runs"),
        pytest.param(runs_losing(1, 1, 0, messages=40), False, id="two of 120"),
        pytest.param(runs_losing(10, 10, 10), False, id="one percent"),
        pytest.param([np.zeros(100, bool)] * 3, True, id="everything"),
    ],
)
def test_advice_needs_more_than_one_percent_for_sure(runs, is_sure):
    assert loss_excesses([runs], 0.01)[0].is_sure() is is_sure


def runs_of(values):
    """Two setups, of as many kinds each."""
    return {(row // 2, "ab"[row % 2]): RunLogarithms(own, tuple(range(len(own)))) for row, own in enumerate(values)}


def test_passes_depend_where_neighbours_are_more_alike():
    assert passes_depend(runs_of(np.cumsum(CHANCE, axis=1)))
    assert not passes_depend(runs_of(CHANCE))
    assert not passes_depend(runs_of(np.zeros((24, 5))))
    # Sizes that move together are as few as setups.
    assert not passes_depend(runs_of(np.tile(CHANCE[:2, :3], (12, 1))))
    assert not passes_depend(runs_of(np.tile([1.0, -2.0, 1.0], (24, 1)) + 0.1 * CHANCE[:, :3]))


def test_few_runs_that_agree_are_no_quieter_than_their_campaign():
    modes = 0.01 * CHANCE[:12, :3] + 0.4 * np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 0]] * 3)
    means = setup_means({(kind, "a"): RunLogarithms(row, (0, 1, 2)) for kind, row in enumerate(modes)})
    assert means[3, "a"].variance == pytest.approx(campaign_variance([modes - modes.mean(axis=1, keepdims=True)]) / 3)
