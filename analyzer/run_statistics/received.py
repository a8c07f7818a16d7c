"""The received ratio of a group with its interval, its change between two sides, and the share of messages later than a deadline.

The rarer of losses and replies decides. If it came in few episodes, their number is Poisson (F. Garwood, Biometrika 28,
1936); if in many, E. B. Wilson's interval (1927) holds for as many independent messages as the variance between the
runs, or within one or two, implies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from ..statistics.distributions import poisson_limits, special, student_cdf, student_quantile
from ..statistics.intervals import MIN_EPISODES, MIN_RUNS, Basis, Interval, mean_and_variance
from ..statistics.power import holm_adjusted, smallest_shift
from .bursts import COSINES, Float64, Int64, episode_sizes, share_inflation
from .change import Change, Verdict
from .runs import Runs
from .two_samples import StudentTest, mover_ends, welch_test

Bools = NDArray[np.bool_]


LEAST_VARIANCE_SHARE = 0.25
"""Runs that are alike by chance do not make the share surer than this part of the variance of independent messages."""

OUTAGE_SHARE = 0.5
"""Runs that are alike by chance do not make the share surer than outages of this part of the mean one would."""


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
        replies / n, low, high, confidence, n, max(1, int(independent)), basis, len(received), units, len(sizes)
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


def _loss_angles(base: Sequence[Bools], new: Sequence[Bools]) -> tuple[Float64, Float64, float]:
    """Return the arcsine of the square root of the share lost by each run of both sides, and the least variance of one.

    The arcsine gives single losses the variance 1 / (4 messages), whatever their share (M. S. Bartlett, Biometrics 3, 1947).
    Its mean depends on the length of the runs, so longer ones count with their first messages only. Outages vary as fewer, larger messages would.
    """
    sides = [[run for run in side if len(run)] for side in (base, new)]
    messages = min(max(map(len, side)) for side in sides)
    before, after = (
        np.array([math.asin(math.sqrt(1 - float(run[:messages].mean()))) for run in side]) for side in sides
    )
    outages = np.concatenate([episode_sizes(np.flatnonzero(~run), len(run)) for side in sides for run in side])
    together = OUTAGE_SHARE * float(outages.mean()) if len(outages) else 0.0
    return before, after, max(1.0, together) / (4 * messages)


def loss_test(base: Float64, new: Float64, least_variance: float) -> StudentTest:
    """Return Welch's test of the angles of the runs: the run is the unit, as losses come in outages.

    Unequal numbers of runs have the degrees of freedom of the fewer: by Welch's, 11 % of equal sides with outages differ.
    """
    test = welch_test(base, new, least_variance)
    fewest, most = sorted(map(len, (base, new)))
    return test if fewest == most else replace(test, degrees=fewest - 1)


@dataclass(frozen=True, slots=True)
class DeliveryChange(Change):
    smallest_drop: float | None = None

    def verdict(self, same_within: float = 0.0) -> Verdict:
        """Return the verdict: the same if the difference is wholly within `+- same_within`."""
        low, high = self.difference_low, self.difference_high
        if self.basis is Basis.WITHIN_RUN or low is None or high is None:
            return Verdict.INCONCLUSIVE
        if -same_within <= low and high <= same_within:
            return Verdict.SAME
        if self.p_value is not None and self.p_value > 1 - self.base.confidence:
            return Verdict.INCONCLUSIVE
        if high < 0:
            return Verdict.WORSE
        return Verdict.BETTER if low > 0 else Verdict.INCONCLUSIVE


def change_of_received(base: Sequence[Bools], new: Sequence[Bools], confidence: float = 0.95) -> DeliveryChange:
    """Return the change of the received ratio.

    The ends follow from the ones of both sides (R. Newcombe, Statistics in Medicine 17, 1998, method 10), between runs widened to
    the ones of `loss_test`, so that they exclude no change where the test does not.
    """
    before, after = (received_interval(side, confidence) for side in (base, new))
    is_between = before.basis is after.basis is Basis.BETWEEN_RUNS
    basis = Basis.BETWEEN_RUNS if is_between else Basis.WITHIN_RUN
    ends = [
        (side.value, side.lower, side.upper)
        for side in (before, after)
        if side.value is not None and side.lower is not None and side.upper is not None
    ]
    if len(ends) < 2:
        return DeliveryChange(before, after, basis)
    difference = ends[1][0] - ends[0][0]
    low, high = mover_ends(*ends)
    if not is_between:
        return DeliveryChange(before, after, basis, difference, low, high)
    base_angles, new_angles, least_variance = _loss_angles(base, new)
    test = loss_test(base_angles, new_angles, least_variance)
    reach, base_angle = test.reach(confidence), float(base_angles.mean())
    fewer, more = mover_ends(
        _shares(base_angle, reach * test.base_error), _shares(base_angle + test.difference, reach * test.new_error)
    )
    shift = base_angle + smallest_shift(test.error, test.degrees, confidence)
    return DeliveryChange(
        base=before,
        new=after,
        difference=difference,
        difference_low=max(-1.0, min(low, difference, -more)),
        difference_high=min(1.0, max(high, difference, -fewer)),
        basis=basis,
        smallest_drop=_share(shift) - _share(base_angle) if shift <= math.pi / 2 else None,
        p_value=test.p_value,
        degrees=test.degrees,
    )


def _shares(angle: float, reach: float) -> tuple[float, float, float]:
    return _share(angle), _share(angle - reach), _share(angle + reach)


def _share(angle: float) -> float:
    return math.sin(min(max(angle, 0.0), math.pi / 2)) ** 2


@dataclass(frozen=True, slots=True)
class LossExcess:
    lost: int
    messages: int
    low: float | None = None
    high: float | None = None
    p_value: float | None = None
    p_adjusted: float | None = None

    @property
    def share(self) -> float:
        return self.lost / self.messages if self.messages else 0.0

    def is_sure(self, confidence: float = 0.95) -> bool:
        if self.p_value is None or self.p_adjusted is None:
            return False
        return self.p_value <= (1 - confidence) / 2 and self.p_adjusted <= 1 - confidence


def loss_excesses(groups: Sequence[Sequence[Bools]], limit: float, confidence: float = 0.95) -> list[LossExcess]:
    """Test for each group of runs, from what each message received, whether more than `limit` is lost in the long run.

    Fewer than `MIN_EPISODES` episodes are a Poisson number of equal ones, of the size that an average loss's has. From there on
    Student's test of the runs' angles (`_loss_angles`) decides, with at least the variance of as many such episodes. Few runs hide how
    much they differ: the test that is adjusted by Holm takes the ratio of both variances from all groups.
    """
    measured = [_Losses([run for run in runs if len(run)]) for runs in groups]
    tested = [sample for sample in measured if sample.runs >= MIN_RUNS]
    lossy = [sample for sample in tested if sample.lost > 1]
    degrees = sum(sample.runs - 1 for sample in lossy)
    ratio = sum((sample.runs - 1) * sample.variance / sample.least for sample in lossy) / max(1, degrees)
    adjusted = iter(
        holm_adjusted([sample.p_value(limit, max(1.0, ratio) * sample.least, degrees) for sample in tested]).tolist()
    )
    return [
        LossExcess(
            *(sample.lost, sample.messages, *sample.ends(confidence)),
            p_value=sample.p_value(limit, sample.least, sample.runs - 1),
            p_adjusted=next(adjusted),
        )
        if sample.runs >= MIN_RUNS
        else LossExcess(sample.lost, sample.messages)
        for sample in measured
    ]


class _Losses:
    def __init__(self, received: Sequence[Bools]) -> None:
        indices = [np.flatnonzero(~run) for run in received]
        self.runs, self.lost, self.messages = len(received), sum(map(len, indices)), sum(map(len, received))
        sizes = [episode_sizes(lost, len(run)) for lost, run in zip(indices, received, strict=True)]
        self.sizes = np.concatenate([np.empty(0, np.int64), *sizes])
        self.episode = float(np.square(self.sizes).sum() / self.lost) if self.lost else 1.0
        angles = np.array(
            [math.asin(math.sqrt(len(lost) / len(run))) for lost, run in zip(indices, received, strict=True)]
        )
        self.angle = float(angles.mean()) if self.runs else 0.0
        self.least = self.episode * self.runs / (4 * max(1, self.messages))
        self.variance = max(float(angles.var(ddof=1)) if self.runs > 1 else 0.0, self.least)

    def p_value(self, limit: float, variance: float, degrees: float) -> float:
        if len(self.sizes) < MIN_EPISODES:
            equal = int(self.lost / self.episode)
            return float(special().gammainc(equal, limit * self.messages / self.episode)) if equal else 1.0
        error = math.sqrt(max(variance, self.variance) / self.runs)
        return student_cdf((math.asin(math.sqrt(limit)) - self.angle) / error, degrees)

    def ends(self, confidence: float) -> tuple[float, float]:
        reach = student_quantile((1 + confidence) / 2, self.runs - 1) * math.sqrt(self.variance / self.runs)
        low, high = _share(self.angle - reach), _share(self.angle + reach)
        if len(self.sizes) < MIN_EPISODES:
            low, high = _few_episodes(self.sizes, self.messages, confidence)
        share = self.lost / max(1, self.messages)
        return min(low, share), max(high, share)


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
    """`upper_of_seen` leaves out bursts that did not come yet."""

    observed: float
    lower: float | None = None
    upper: float | None = None
    upper_of_seen: float | None = None


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
    upper, unseen = max(mean + reach, predicted), _unseen_limit(is_late, confidence)
    return LateShare(observed, max(0.0, mean - reach), min(1.0, max(upper, unseen)), min(1.0, upper))


UNSEEN_BURST = 4.5
"""Late messages of it, by simulation (`coverage-deadlines-bursts`)."""


def _unseen_limit(is_late: Sequence[Bools], confidence: float) -> float:
    """Return Poisson's upper limit by the bursts that came, or one, of their mean size and that of another one."""
    sizes = [episode_sizes(np.flatnonzero(late), len(late)) for late in is_late]
    bursts = np.concatenate([*sizes, [UNSEEN_BURST]])
    if len(bursts) > MIN_EPISODES:
        return 0.0
    most = poisson_limits(max(len(bursts) - 1, 1), (1 + 2 * confidence) / 3)[1]  # one of three upper limits
    return most * float(bursts.mean()) / sum(map(len, is_late))


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
