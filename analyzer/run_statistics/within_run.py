"""The interval of a quantile or a mean from one series: it holds for this run, not for the next.

Of n independent values the number below the q-quantile is binomial(n, q) whatever the distribution, so two of the
sorted values enclose it with a probability that can be computed (H. A. David and H. N. Nagaraja, "Order Statistics",
3rd ed. 2003, section 7.1). Dependent messages count for fewer: n is divided by the variance inflation of the series
"beyond the quantile or not" (`bursts`), and by what Student's t asks for because that inflation is an estimate.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.distributions import student_quantile
from ..statistics.intervals import Basis, Interval, without_open_end
from ..statistics.order_statistics import order_statistic_ranks
from .bursts import COSINES, long_run_variance
from .runs import Runs, quantile_at
from .tails import episodes_of, tails_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .runs import Run, Statistic


def interval_within(runs: Sequence[Run], statistic: Statistic, confidence: float = 0.95) -> Interval:
    """Return the interval of a statistic within one run.

    The value is the summary's: the mean, or the quantile by linear interpolation (Hyndman and Fan's definition 7).
    An end beyond the tail is None if the messages there came in fewer than `EPISODES_TO_TELL` episodes.

    Args:
        runs: one run, or a few that are taken as one series.
        statistic: what is estimated.
        confidence: between 0 and 1, both excluded.
    """
    group = Runs.of(runs).joined
    (series,) = group
    if not runs or len(series) < statistic.needs:
        samples = sum(len(run) for run in runs)
        return Interval(None, None, None, confidence, samples, samples, Basis.WITHIN_RUN, len(runs), 0, None)
    if statistic.quantile is None:
        return _mean_within(series, confidence, len(runs))
    return _quantile_within(group, statistic.quantile, confidence, len(runs))


def _quantile_within(group: Runs, quantile: float, confidence: float, runs: int) -> Interval:
    (series,) = group
    n, ordered = len(series), series.ordered
    (tail,) = tails_of(group, quantile)
    episodes = episodes_of([tail])
    independent = max(1, int(n / max(1.0, tail.inflation * _price_of_estimating(confidence))))
    lowest, highest = order_statistic_ranks(independent, quantile, confidence)
    stretch = n / independent
    lower = None if lowest is None else float(ordered[math.floor((lowest - 1) * stretch)])
    upper = None if highest is None else float(ordered[math.ceil(round(highest * stretch, 6)) - 1])
    lower, upper = without_open_end(lower, upper, quantile, episodes)
    return Interval(
        value=quantile_at(ordered, 1 + (n - 1) * quantile),
        lower=lower,
        upper=upper,
        confidence=confidence,
        samples=n,
        independent=independent,
        basis=Basis.WITHIN_RUN,
        runs=runs,
        units=0,
        episodes=episodes,
    )


def _mean_within(series: Run, confidence: float, runs: int) -> Interval:
    n, mean = len(series), float(series.values.mean())
    if n <= 2 * COSINES or math.isinf(mean):
        upper = mean if math.isinf(mean) else None
        return Interval(mean, None, upper, confidence, n, n, Basis.WITHIN_RUN, runs, 0, None)
    centred = series.values - mean
    variance = max(float(np.square(centred).mean()) * n / (n - 1), long_run_variance(series.values))
    reach = student_quantile((1 + confidence) / 2, COSINES) * math.sqrt(variance / n)
    spread = float(np.square(centred).mean())
    independent = n if variance == 0 else max(1, int(n * spread / variance))
    return Interval(
        mean, mean - reach, mean + reach, confidence, n, independent, Basis.WITHIN_RUN, runs, 0, None
    )


def _price_of_estimating(confidence: float) -> float:
    """Return the square of Student's t for `COSINES` degrees of freedom over the normal's: 1.24 at 95 %."""
    probability = (1 + confidence) / 2
    return (student_quantile(probability, COSINES) / NormalDist().inv_cdf(probability)) ** 2
