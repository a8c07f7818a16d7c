"""Series with a known truth: correlated, in bursts, in runs that differ."""

import math

import numpy as np

from dds_trace.analyzer.run_statistics.between_runs import estimates_of_runs
from dds_trace.analyzer.run_statistics.change import change_of_estimates


def autoregressive(runs: int, messages: int, correlation: float, seed: int):
    values = np.random.default_rng(seed).standard_normal((messages, runs))
    for place in range(1, messages):
        values[place] = correlation * values[place - 1] + math.sqrt(1 - correlation**2) * values[place]
    return values.T


def log_normal_groups(groups: int, runs: int, messages: int, spread: float, seed: int, correlation: float = 0.0):
    """Groups of runs with median 1: messages spread by 50 %, runs by `spread`; shape (groups, runs, messages)."""
    values = 0.5 * autoregressive(groups * runs, messages, correlation, seed)
    levels = spread * np.random.default_rng([seed, 1]).standard_normal((groups * runs, 1))
    return np.exp(values + levels).reshape(groups, runs, messages)


def change_of_runs(base, new, statistic, confidence=0.95, passes=None):
    before, after = (estimates_of_runs(side, [statistic], confidence)[0] for side in (base, new))
    return change_of_estimates(before, after, passes)
