"""The received ratio of a group with its interval, and its change between two sides.

The rarer of losses and replies decides. If it came in few episodes, their number is Poisson (F. Garwood, Biometrika 28, 1936); if
in many, E. B. Wilson's interval (1927) holds for as many independent messages as the variance between the runs, or within one
or two, implies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.distributions import poisson_limits, student_quantile
from ..statistics.intervals import MIN_EPISODES, MIN_RUNS, Basis, Interval
from ..statistics.power import smallest_shift
from .bursts import COSINES, episode_sizes, share_inflation
from .change import Verdict
from .two_samples import mover_ends

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Bools = NDArray[np.bool_]
    Int64 = NDArray[np.int64]

LEAST_VARIANCE_SHARE = 0.25
"""Runs that are alike by chance do not make the share surer than this part of the variance of independent messages."""


def received_interval(received: Sequence[Bools], confidence: float = 0.95) -> Interval:
    """Return the share of received messages, a bool for each message of each run in the order of time, with its interval.

    Without a loss the lower end assumes that losses come singly.
    """
    runs = [run for run in received if len(run)]
    basis = Basis.BETWEEN_RUNS if len(runs) >= MIN_RUNS else Basis.WITHIN_RUN
    n = sum(map(len, runs))
    if not n:
        return Interval(None, None, None, confidence, 0, 0, basis, len(received), 0, None)
    replies = sum(int(np.count_nonzero(run)) for run in runs)
    replies_are_rare = 2 * replies < n
    events = runs if replies_are_rare else [~run for run in runs]
    sizes = np.concatenate([episode_sizes(np.flatnonzero(run), len(run)) for run in events])
    share = (replies if replies_are_rare else n - replies) / n
    independent = _independent(events, share, n)
    if len(sizes) < MIN_EPISODES:
        low, high = _few_episodes(sizes, n, confidence)
    else:
        degrees = len(runs) - 1 if basis is Basis.BETWEEN_RUNS else COSINES
        low, high = wilson_ends(share, independent, student_quantile((1 + confidence) / 2, degrees))
    low, high = (low, high) if replies_are_rare else (1 - high, 1 - low)
    units = len(runs) if basis is Basis.BETWEEN_RUNS else 0
    return Interval(
        replies / n,
        low,
        high,
        confidence,
        n,
        max(1, int(independent)),
        basis,
        len(received),
        units,
        len(sizes),
    )


def _independent(events: Sequence[Bools], share: float, n: int) -> float:
    variance_of_independent = share * (1 - share) / n
    if variance_of_independent == 0:
        return n
    if len(events) >= MIN_RUNS:
        # The share of all messages is a ratio of two sums over runs (W. G. Cochran, "Sampling Techniques", 1977, 6.3).
        weights = np.array([len(run) for run in events]) / n
        apart = weights * (np.array([run.mean() for run in events]) - share)
        variance = float(np.square(apart).sum()) * len(events) / (len(events) - 1)
    else:
        variance = variance_of_independent * share_inflation(np.flatnonzero(np.concatenate(events)), n)
    return n * variance_of_independent / max(variance, LEAST_VARIANCE_SHARE * variance_of_independent)


def _few_episodes(sizes: Int64, n: int, confidence: float) -> tuple[float, float]:
    """Return the ends of the share of messages in a Poisson number of episodes.

    The upper end takes an episode to be as long as an average message's one, the lower end as the mean one.
    """
    fewest, most = poisson_limits(len(sizes), confidence)
    if not len(sizes):
        return 0.0, min(most / n, 1.0)
    mean = float(sizes.mean())
    weighted = max(2 * mean - 1, float(np.square(sizes).sum() / sizes.sum()))
    return fewest * mean / n, min(most * weighted / n, 1.0)


def wilson_ends(share: float, independent: float, quantile: float) -> tuple[float, float]:
    """Return the ends of the interval of a share (E. B. Wilson, JASA 22, 1927) of so many independent observations."""
    squared = quantile * quantile
    centre = share + squared / (2 * independent)
    reach = quantile * math.sqrt(share * (1 - share) / independent + squared / (4 * independent**2))
    scale = 1 + squared / independent
    return max(0.0, (centre - reach) / scale), min(1.0, (centre + reach) / scale)


@dataclass(frozen=True, slots=True)
class DeliveryChange:
    """Received ratios of both sides; what the samples do not support is None.

    Attributes:
        base: interval of the base's received ratio.
        new: the same of the new side.
        difference: new - base, between -1 and 1.
        basis: between runs only if both sides have three.
        smallest_drop: the smallest loss of share that these runs would have detected with a probability of 80 %, with the reach
            below the difference as Student's t.
    """

    base: Interval
    new: Interval
    difference: float | None
    difference_low: float | None
    difference_high: float | None
    basis: Basis
    smallest_drop: float | None = None

    def verdict(self, same_within: float = 0.0) -> Verdict:
        """Return the verdict: the same if the difference is wholly within `+- same_within`."""
        low, high = self.difference_low, self.difference_high
        if self.basis is Basis.WITHIN_RUN or low is None or high is None:
            return Verdict.INCONCLUSIVE
        if -same_within <= low and high <= same_within:
            return Verdict.SAME
        if high < 0:
            return Verdict.WORSE
        return Verdict.BETTER if low > 0 else Verdict.INCONCLUSIVE


def change_of_received(
    base: Sequence[NDArray[np.bool_]], new: Sequence[NDArray[np.bool_]], confidence: float = 0.95
) -> DeliveryChange:
    """Return the change of the received ratio, its ends by R. Newcombe (Statistics in Medicine 17, 1998, method 10)."""
    sides = [received_interval(side, confidence) for side in (base, new)]
    is_between = all(side.basis is Basis.BETWEEN_RUNS for side in sides)
    basis = Basis.BETWEEN_RUNS if is_between else Basis.WITHIN_RUN
    before, after = sides
    ends = [
        (side.value, side.lower, side.upper)
        for side in sides
        if side.value is not None and side.lower is not None and side.upper is not None
    ]
    if len(ends) < len(sides):
        return DeliveryChange(before, after, None, None, None, basis)
    low, high = mover_ends(*ends)
    difference = ends[1][0] - ends[0][0]
    smallest = None
    if is_between:
        degrees = min(side.runs for side in sides) - 1
        error = (difference - low) / student_quantile((1 + confidence) / 2, degrees)
        smallest = smallest_shift(error, degrees, confidence)
    return DeliveryChange(before, after, difference, low, high, basis, smallest)
