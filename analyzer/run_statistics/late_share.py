"""The share of messages later than a deadline, a run being one observation, with a limit that it very likely does not exceed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from ..statistics.distributions import special, student_quantile
from ..statistics.intervals import MIN_RUNS, mean_and_variance
from .runs import Float64, Runs

_NORMAL = NormalDist()
_STEPS, _BINS = 25, 128
_GRID = np.linspace(-8.0, 8.0, 3201)
_CUMULATIVE = np.maximum([_NORMAL.cdf(z) for z in _GRID.tolist()], np.exp(np.minimum(_GRID - 1, 0)))
"""Probability that a run is so many standard deviations slower than the mean, or more, at the negative of these: the normal one, or the
exponential one of levels that are skewed, whichever is larger. With the normal one, skewed runs are said to meet in 12 to 21 %."""

SKEWED = 0.5
"""By simulation (`coverage-deadlines-kinds`)."""


@dataclass(frozen=True, slots=True)
class LateShare:
    observed: float
    lower: float | None = None
    upper: float | None = None


def late_share(runs: Runs, deadline_ns: float, confidence: float = 0.95) -> LateShare | None:
    """Return the late share of runs of values in ns, infinite for a lost message; None without a message.

    Each limit is wrong with half of the rest of the confidence. The first upper limit is Student's of the runs' late
    shares. By itself it is too low where no run was late yet. The second one takes the logarithm of a value as the
    run's level plus a residual, and levels as normal or, where that is more, exponential beyond their mean.
    """
    filled = [run.values for run in runs if len(run)]
    if not filled:
        return None
    is_late = [values > deadline_ns for values in filled]
    observed = float(np.concatenate(is_late).mean())
    if len(filled) < MIN_RUNS:
        return LateShare(observed)
    shares = np.array([late.mean() for late in is_late])
    mean, variance = mean_and_variance(shares)
    reach = student_quantile((1 + confidence) / 2, len(shares) - 1) * math.sqrt(variance / len(shares))
    logs = [np.log(np.maximum(values, 1.0)) for values in filled]
    predicted = _predicted_limit(logs, math.log(deadline_ns), (1 + confidence) / 2)
    return LateShare(observed, max(0.0, mean - reach), min(1.0, max(mean + reach, predicted)))


def _predicted_limit(logs: list[Float64], deadline: float, probability: float) -> float:
    """Return the upper limit of the late share by the levels of the runs.

    A generalized confidence limit (S. Weerahandi, JASA 88, 1993; for tolerance limits of groups K. Krishnamoorthy and
    T. Mathew, Technometrics 46, 2004): normal and chi-square variables replace mean and deviation of the levels; the
    limit is the quantile of the late shares that follow.
    """
    levels = np.array([run[np.isfinite(run)].mean() if np.isfinite(run).any() else np.inf for run in logs])
    if not np.isfinite(levels).all():
        return 1.0
    residuals = np.concatenate([run - level for run, level in zip(logs, levels.tolist(), strict=True)])
    is_finite = np.isfinite(residuals)
    counts, edges = np.histogram(residuals[is_finite], _BINS)
    mean, variance = mean_and_variance(levels)
    normal, ratio = _pivots(len(levels))
    deviation = math.sqrt(max(variance, 1e-18)) * ratio
    level = mean + normal * deviation / math.sqrt(len(levels))
    # The upper edge of each bin replaces its residuals: the limit gets no lower.
    beyond = (level[:, None] + edges[1:] - deadline) / deviation[:, None]
    late = np.interp(beyond, _GRID, _CUMULATIVE) @ (counts / len(residuals)) + (1 - is_finite.mean())
    return float(np.quantile(late, probability))


@lru_cache(maxsize=64)
def _pivots(runs: int) -> tuple[Float64, Float64]:
    """Return equally likely pairs of a normal variable and the ratio of true to observed deviation, `sqrt((n-1) / chi-square)`.

    The ratio is larger by `SKEWED / n`, as the fewer skewed runs there are, the lower both their mean and their deviation tend to be.
    """
    halves, shares = (runs - 1) / 2, (np.arange(_STEPS) + 0.5) / _STEPS
    ratios = np.sqrt(halves / special().gammaincinv(halves, shares))
    return np.repeat(special().ndtri(shares), _STEPS), np.tile(ratios * (1 + SKEWED / runs), _STEPS)
