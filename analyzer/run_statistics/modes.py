"""The shape of one run: a warm-up at its start, a trend over its time, two modes of its values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..statistics.distributions import student_cdf
from ..statistics.percentiles import quantile_of
from .bursts import COSINES, Float64, long_run_variance

BATCH = 5
WARM_UP_MIN_MESSAGES = 40 * BATCH
WARM_UP_P_VALUE = 1e-3
"""Small, because MSER picks the most extreme of many starts."""

HEAD_SHARE = 0.5
"""Share of the difference in the first quarter of a warm-up: MSER also cuts after a later burst."""


@dataclass(frozen=True, slots=True)
class WarmUp:
    messages: int
    ratio: float
    p_value: float

    def is_sure(self, at_least: float = 0.0) -> bool:
        change = max(self.ratio, 1 / self.ratio) - 1
        return self.messages > 0 and self.p_value <= WARM_UP_P_VALUE and change >= at_least


def find_warm_up(values: NDArray[Any]) -> WarmUp | None:
    """Return the warm-up of a run by MSER-5; None in less than `WARM_UP_MIN_MESSAGES` messages.

    The batches to leave out minimize the standard error of the mean of the rest (K. P. White, Simulation 69, 1997, with batches
    of five as in K. P. White, M. Cobb and S. Spratt, WSC 2000); they are medians of logarithms, which one late message does not move.
    The heuristic always proposes a cut, so it is tested: the start must differ from its first quarter on, more than any stretch of
    the rest of the same length, and by more than the long-run variance of the rest explains.
    """
    if len(values) < WARM_UP_MIN_MESSAGES:
        return None
    count = len(values) // BATCH
    # The logarithm of a median is the median of the logarithms.
    batches = np.log(medians_of_five(values[: count * BATCH].reshape(count, BATCH)).astype(np.float64))
    left_out = mser_truncation(batches)
    if not left_out:
        return WarmUp(0, 1.0, 1.0)
    start, remainder = batches[:left_out], batches[left_out:]
    difference = float(start.mean() - remainder.mean())
    head = float(start[: max(1, len(start) // 4)].mean() - remainder.mean())
    count = len(remainder) // left_out
    windows = remainder[: count * left_out].reshape(count, left_out).mean(axis=1) - remainder.mean()
    if head / difference < HEAD_SHARE or abs(difference) <= np.abs(windows).max():
        return WarmUp(0, 1.0, 1.0)
    variance = max(float(remainder.var(ddof=1)), long_run_variance(remainder))
    error = math.sqrt(variance * (1 / len(start) + 1 / len(remainder)))
    t = abs(difference) / error if error else math.inf
    return WarmUp(left_out * BATCH, math.exp(difference), 2 * student_cdf(-t, COSINES))


def medians_of_five(batches: NDArray[Any]) -> NDArray[Any]:
    a, b, c, d, e = batches.T
    low, high = np.maximum(np.minimum(a, b), np.minimum(c, d)), np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.asarray(np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e)))


def mser_truncation(series: Float64) -> int:
    """Return the d <= n / 4 that minimizes `sum (x - mean)^2 / (n - d)^2` without the first d values."""
    n = len(series)
    centred = series - series.mean()
    at_risk = np.arange(n, 0, -1)
    sums = np.cumsum(centred[::-1])[::-1]
    squares = np.cumsum(np.square(centred)[::-1])[::-1]
    about_mean = squares - sums * sums / at_risk
    about_mean[about_mean <= n * np.finfo(np.float64).eps * squares[0]] = 0  # equal values leave rounding only
    criterion = about_mean / (at_risk * at_risk)
    return int(np.argmin(criterion[: n // 4 + 1]))


BLOCKS = 32
_FIRST, _SECOND = np.triu_indices(BLOCKS, 1)
TREND_MIN_MESSAGES = 4 * BLOCKS
TREND_P_VALUE = 0.001
"""Small, because a campaign has hundreds of runs."""


@dataclass(frozen=True, slots=True)
class Trend:
    change: float
    p_value: float

    def is_sure(self, at_least: float = 0.0) -> bool:
        return self.p_value <= TREND_P_VALUE and abs(self.change) >= at_least


def find_trend(values: NDArray[Any]) -> Trend | None:
    """Return the trend of a run; None in less than `TREND_MIN_MESSAGES` messages.

    The medians of 32 blocks, which a burst does not move, are tested by their order (H. Mann, 1945; M. Kendall, 1948).
    The variance of the test is multiplied by (1 + r)/(1 - r), where r is the correlation of neighbouring blocks about
    the line (S. Yue and C. Wang, Water Resources Management 18, 2004), with Kendall's correction of its bias.
    """
    if len(values) < TREND_MIN_MESSAGES:
        return None
    medians = block_medians(values, BLOCKS)
    rises = medians[_SECOND] - medians[_FIRST]
    slope = quantile_of(np.sort(rises / (_SECOND - _FIRST)), 0.5)
    from_middle = np.arange(BLOCKS) - (BLOCKS - 1) / 2
    correlation = _correlation_of_neighbours(medians - slope * from_middle)
    variance = BLOCKS * (BLOCKS - 1) * (2 * BLOCKS + 5) / 18 * (1 + correlation) / (1 - correlation)
    score = float(np.sign(rises).sum())
    z = max(0.0, abs(score) - 1) / math.sqrt(variance)  # a score moves in steps of two
    middle, reach = quantile_of(np.sort(medians), 0.5), slope * (BLOCKS - 1) / 2
    start = max(middle - reach, float(medians.min()), np.finfo(np.float64).tiny)
    return Trend(change=(middle + reach) / start - 1, p_value=2 * student_cdf(-z, math.inf))


def block_medians(values: NDArray[Any], blocks: int) -> Float64:
    length = len(values) // blocks
    ordered = np.sort(values[: length * blocks].reshape(blocks, length), axis=1)  # faster than numpy.median
    return np.asarray((ordered[:, (length - 1) // 2] + ordered[:, length // 2]) / 2, np.float64)


def _correlation_of_neighbours(series: Float64) -> float:
    """Return the correlation of neighbours by ranks, 0 to 0.95, less its bias of -(1 + 3 r)/n (M. Kendall, 1954)."""
    # Rounded, because the rest of a straight line is the error of its arithmetic.
    rounded = np.round(series / max(float(np.abs(series).max()), np.finfo(np.float64).tiny), 9)
    ordered = np.sort(rounded)
    ranks = np.searchsorted(ordered, rounded, "left") + np.searchsorted(ordered, rounded, "right")
    centred = ranks - ranks.mean()
    if not centred.any():
        return 0.0
    biased = float(centred[1:] @ centred[:-1]) / float(centred @ centred)
    return min(max(biased + (1 + 3 * biased) / len(series), 0.0), 0.95)


MODES_MIN_MESSAGES = 200
LEAST_SHARE = 0.1
"""Least share of the smaller mode."""

DEEPEST_VALLEY = 0.5
"""Density between the modes over the lower one's."""

LEAST_VALUES = 30
"""Different values: a coarse clock makes modes of its ticks."""

SURE_DEVIATIONS = 4.0
"""No simulated run with one mode has two."""

_BINS = 256


@dataclass(frozen=True, slots=True)
class Modes:
    """The two modes of a series: peaks, `share` of the smaller, and `valley` between them over the lower peak."""

    low: float
    high: float
    share: float
    valley: float


def find_modes(ordered: NDArray[Any], inflation: float = 1.0) -> Modes | None:
    """Return the two modes of ascending values above zero; None if there is one, or too few messages or different values.

    The density of the logarithms is estimated with a normal kernel of B. W. Silverman's width (1986, equation 3.31:
    0.9 min(deviation, interquartile range / 1.34) n^(-1/5)), with n the independent messages. Two peaks are modes if the smaller
    has a tenth of the messages, and if the valley is at most half as high as the lower peak and too low for chance by four standard
    deviations. `inflation` is the `share_inflation` about the median.
    """
    n = len(ordered) / max(1.0, inflation)
    if n < MODES_MIN_MESSAGES:
        return None
    logs = np.log(ordered.astype(np.float64))
    low, first, third, high = (quantile_of(logs, quantile) for quantile in (0.005, 0.25, 0.75, 0.995))
    deviation = min(float(np.clip(logs, low, high).std()), (third - first) / 1.34)
    sample = ordered[:: max(1, len(ordered) // 10_000)]
    if deviation <= 0 or np.count_nonzero(sample[1:] != sample[:-1]) + 1 < LEAST_VALUES:
        return None
    width = 0.9 * deviation * n ** (-1 / 5)
    edges = np.linspace(low - 3 * width, high + 3 * width, _BINS + 1)
    counts = np.diff(logs.searchsorted(edges)).astype(np.float64) / max(1.0, inflation)
    kernel_bins = width / (edges[1] - edges[0])
    density = np.convolve(counts, _kernel(round(max(kernel_bins, 0.5), 2)), mode="same")
    return _deepest(density, counts, (edges[1:] + edges[:-1]) / 2, kernel_bins)


@lru_cache(maxsize=64)
def _kernel(deviation: float) -> Float64:
    reach = math.ceil(4 * deviation)
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / deviation))
    return np.asarray(weights / weights.sum())


def _deepest(density: Float64, counts: Float64, centres: Float64, kernel_bins: float) -> Modes | None:
    peak_before = np.maximum.accumulate(density)
    right = np.maximum.accumulate(density[::-1])[::-1]
    lower_peak = np.minimum(peak_before, right)
    below = np.cumsum(counts)
    share = np.minimum(below, below[-1] - below) / below[-1]
    # A smoothed count under a normal kernel of s bins has a variance of itself / (2 sqrt(pi) s).
    noise = np.sqrt((density + lower_peak) / (2 * math.sqrt(math.pi) * max(kernel_bins, 0.5)))
    is_valley = (
        (share >= LEAST_SHARE)
        & (density <= DEEPEST_VALLEY * lower_peak)
        & (lower_peak - density >= SURE_DEVIATIONS * noise)
    )
    valleys = is_valley.nonzero()[0]
    if not len(valleys):
        return None
    valley = int(valleys[np.argmin(density[valleys] / lower_peak[valleys])])
    low_peak, high_peak = int(np.argmax(density[:valley])), valley + int(np.argmax(density[valley:]))
    return Modes(
        low=math.exp(centres[low_peak]),
        high=math.exp(centres[high_peak]),
        share=float(share[valley]),
        valley=float(density[valley] / lower_peak[valley]),
    )
