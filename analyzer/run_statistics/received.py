"""The received ratio of a group with its interval: losses come in episodes, and runs differ.

What is rarer, losses or replies, carries the information. Where it came in few episodes, their number is Poisson and
decides (F. Garwood, "Fiducial limits for the Poisson distribution", Biometrika 28, 1936); where in many, the share
is asymptotically normal, and E. B. Wilson's interval (1927) holds for as many independent messages as its variance
says, measured between the runs or, for one or two, within them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.distributions import poisson_limits, student_quantile
from ..statistics.intervals import MIN_EPISODES, MIN_RUNS, Basis, Interval
from .bursts import COSINES, episode_sizes, share_inflation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Bools = NDArray[np.bool_]
    Int64 = NDArray[np.int64]

LEAST_VARIANCE_SHARE = 0.25
"""Runs that are alike by chance do not make the share surer than this part of the variance of independent messages."""


def received_interval(received: Sequence[Bools], confidence: float = 0.95) -> Interval:
    """Return the share of messages whose reply came back, of a group of runs, with its interval.

    `episodes` counts the episodes of what is rarer, losses or replies. Where nothing was lost the lower end supposes
    that losses come singly (`episodes` is 0): that outages are rarer than that, no run without one can tell.

    Args:
        received: for each run a bool for each message in the order of time, False for a lost or never sent one.
        confidence: between 0 and 1, both excluded.
    """
    held = [run for run in received if len(run)]
    basis = Basis.BETWEEN_RUNS if len(held) >= MIN_RUNS else Basis.WITHIN_RUN
    n = sum(len(run) for run in held)
    if not n:
        return Interval(None, None, None, confidence, 0, 0, basis, len(received), 0, None)
    came = sum(int(np.count_nonzero(run)) for run in held)
    replies_are_rare = 2 * came < n
    events = held if replies_are_rare else [~run for run in held]
    sizes = np.concatenate([episode_sizes(np.flatnonzero(run), len(run)) for run in events])
    share = (came if replies_are_rare else n - came) / n
    independent = _independent(events, share, n)
    if len(sizes) < MIN_EPISODES:
        low, high = _few_episodes(sizes, n, confidence)
    else:
        degrees = len(held) - 1 if basis is Basis.BETWEEN_RUNS else COSINES
        low, high = wilson_ends(share, independent, student_quantile((1 + confidence) / 2, degrees))
    low, high = (low, high) if replies_are_rare else (1 - high, 1 - low)
    units = len(held) if basis is Basis.BETWEEN_RUNS else 0
    return Interval(
        came / n, low, high, confidence, n, max(1, int(independent)), basis, len(received), units, len(sizes)
    )


def _independent(events: Sequence[Bools], share: float, n: int) -> float:
    """Return the independent messages whose share of events would vary as much as that of these runs."""
    of_independent = share * (1 - share) / n
    if of_independent == 0:
        return n
    if len(events) >= MIN_RUNS:
        # The share of all messages is a ratio of two sums over runs (W. G. Cochran, "Sampling Techniques", 1977, 6.3).
        weights = np.array([len(run) for run in events]) / n
        apart = weights * (np.array([run.mean() for run in events]) - share)
        variance = float(np.square(apart).sum()) * len(events) / (len(events) - 1)
    else:
        variance = of_independent * share_inflation(np.flatnonzero(np.concatenate(events)), n)
    return n * of_independent / max(variance, LEAST_VARIANCE_SHARE * of_independent)


def _few_episodes(sizes: Int64, n: int, confidence: float) -> tuple[float, float]:
    """Return the ends of the share of messages in episodes whose number is Poisson.

    The upper end takes an episode to be as long as the one that a message of an episode is in, on average; the
    lower end as the mean one. Without an episode the events are supposed to come singly.
    """
    fewest, most = poisson_limits(len(sizes), confidence)
    if not len(sizes):
        return 0.0, min(most / n, 1.0)
    mean = float(sizes.mean())
    weighted = max(2 * mean - 1, float(np.square(sizes).sum() / sizes.sum()))
    return fewest * mean / n, min(most * weighted / n, 1.0)


def wilson_ends(share: float, independent: float, quantile: float) -> tuple[float, float]:
    """Return the ends of the interval of a share (E. B. Wilson, JASA 22, 1927).

    Args:
        share: the one that was seen.
        independent: independent observations it is worth.
        quantile: how many standard errors it reaches; the normal's or Student's quantile.
    """
    squared = quantile * quantile
    centre = share + squared / (2 * independent)
    reach = quantile * math.sqrt(share * (1 - share) / independent + squared / (4 * independent**2))
    scale = 1 + squared / independent
    return max(0.0, (centre - reach) / scale), min(1.0, (centre + reach) / scale)
