"""Block length and inflation of series whose correlation is known by formula."""

from __future__ import annotations

import numpy as np
import pytest
from series import autoregressive

from dds_trace.analyzer.statistics.dependence import dependence_of


def test_independent_messages_count_in_full():
    found = [dependence_of(autoregressive(1000, 0.0, seed)) for seed in range(20)]
    assert sum(d.inflation < 1.3 for d in found) >= 17


def test_inflation_of_a_known_series():
    # An autoregressive series with correlation r of neighbours: (1 + r) / (1 - r), so 3 for 0.5 and 9 for 0.8.
    for correlation, inflation in ((0.5, 3.0), (0.8, 9.0)):
        found = [dependence_of(autoregressive(20_000, correlation, seed)) for seed in range(5)]
        assert np.mean([d.inflation for d in found]) == pytest.approx(inflation, rel=0.15)


def test_block_length_grows_as_politis_and_white_say():
    # b = (2 G^2 / D)^(1/3) n^(1/3), G = 2r / (1 - r)^2 sigma^2, D = 4/3 g(0)^2, g(0) = (1 + r) / (1 - r) sigma^2:
    # r = 0.5 gives G / g(0) = 4/3, b = (1.5 * 16/9)^(1/3) * 20000^(1/3) = 1.387 * 27.14 = 37.6.
    found = [dependence_of(autoregressive(20_000, 0.5, seed)).block_messages for seed in range(5)]
    assert np.mean(found) == pytest.approx(37.6, rel=0.25)


def test_constant_short_and_alternating_series_are_taken_as_independent():
    for series in (np.ones(500), np.arange(5), np.tile([0, 1], 200), np.empty(0)):
        assert dependence_of(series).block_messages == 1
        assert dependence_of(series).inflation == 1.0


def test_a_series_of_bursts_is_worth_fewer_messages():
    bursts = np.repeat(np.random.default_rng(3).random(200) < 0.1, 20)
    assert dependence_of(bursts).inflation > 8


@pytest.mark.parametrize(
    ("correlation", "messages", "seed", "block"),
    [
        (0.3, 20_000, 1, 22.485),
        (0.3, 20_000, 2, 24.183),
        (0.5, 2_000, 1, 15.876),
        (0.5, 20_000, 2, 38.954),
        (0.8, 200, 1, 19.953),
        (0.8, 2_000, 2, 30.738),
        (0.8, 20_000, 1, 79.541),
        (0.95, 2_000, 1, 85.925),
        (0.95, 20_000, 2, 270.203),
    ],
)
def test_block_lengths_are_those_of_arch(correlation, messages, seed, block):
    # `arch.bootstrap.optimal_block_length(series)["circular"]` of arch 8.0.0, which searches the lags a little otherwise.
    found = dependence_of(autoregressive(messages, correlation, seed)).block_messages
    assert found == pytest.approx(block, rel=0.1)
