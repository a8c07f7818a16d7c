"""The block bootstrap against formulas, and its draws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from series import autoregressive

from dds_trace.analyzer.statistics.bootstrap import bootstrap_mean, bootstrap_quantile
from dds_trace.analyzer.statistics.dependence import dependence_of


def test_the_bootstrap_spreads_as_the_mean_does():
    values = autoregressive(400, 0.0, 1)
    assert bootstrap_mean(values).std() == pytest.approx(values.std() / 20, rel=0.1)
    alike = [autoregressive(2000, 0.8, seed) for seed in range(8)]
    spread = np.mean([bootstrap_mean(v, dependence_of(v).block_messages).std() for v in alike])
    assert spread == pytest.approx(3 / math.sqrt(2000), rel=0.2)  # inflation 9 of the variance


def test_the_bootstrap_spreads_as_a_quantile_does():
    drawn = [np.quantile(autoregressive(1000, 0.5, seed), 0.9) for seed in range(300)]
    found = []
    for seed in range(10):
        values = autoregressive(1000, 0.5, seed)
        block = dependence_of(values <= np.quantile(values, 0.9)).block_messages
        found.append(bootstrap_quantile(values, 0.9, block).std())
    assert np.mean(found) == pytest.approx(np.std(drawn), rel=0.15)


def test_bootstrap_draws_come_from_the_sample_and_are_the_same_each_time():
    values = np.random.default_rng(1).permutation(3000) * 10
    first = bootstrap_quantile(values, 0.99, 4)
    assert first.shape == (499,)
    assert set(first.tolist()) <= set(values.tolist())
    assert np.array_equal(first, bootstrap_quantile(values, 0.99, 4))
    assert not np.array_equal(first, bootstrap_quantile(values, 0.99, 4, seed=7))
    assert bootstrap_quantile(np.array([42]), 0.5).tolist() == [42.0] * 499


@pytest.mark.parametrize(
    ("correlation", "messages", "quantile", "block", "of_quantile", "of_mean"),
    [
        (0.0, 1_000, 0.5, 1, 0.040347, 0.030907),
        (0.5, 1_000, 0.9, 10, 0.073846, 0.049654),
        (0.8, 5_000, 0.99, 29, 0.093550, 0.038714),
    ],
)
def test_the_bootstrap_spreads_as_that_of_arch(correlation, messages, quantile, block, of_quantile, of_mean):
    # Standard deviations of 2000 replicates of `arch.bootstrap.CircularBlockBootstrap` (arch 8.0.0, seed 1), which resamples
    # every message where ours resamples cells; each has a standard error of 1.6 %.
    series = autoregressive(messages, correlation, 3)
    assert dependence_of(series <= np.quantile(series, quantile)).block_messages == block
    drawn = bootstrap_quantile(series, quantile, block, replicates=2000)
    assert drawn.std() == pytest.approx(of_quantile, rel=0.08)
    means = bootstrap_mean(series, dependence_of(series).block_messages, replicates=2000)
    assert means.std() == pytest.approx(of_mean, rel=0.08)
