"""A short warm-up: messages at the begin of a run that are not like the others, which a run had better leave out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..statistics.distributions import student_cdf
from .bursts import COSINES, long_run_variance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]

BATCH = 5
MESSAGES_TO_TELL = 40 * BATCH
P_VALUE_TO_TELL = 1e-3
"""MSER picks the most extreme of many begins, so that the p value of the one it picks is too small. Simulated with 1000
runs each of 300, 1000 and 5000 messages, a run without a warm-up is taken for one with a warm-up in at most 0.7 %
(correlation of neighbours 0 to 0.95; log-normal, exponential, Pareto) and 3.1 % where one message in twenty is in a burst of
20, some of which begin the run. Twenty messages that are three times as slow, where messages spread by 50 %, are found in
89 %."""

HEAD_SHARE = 0.5
"""Share of the difference that the first quarter of a warm-up must have: MSER also cuts behind a burst that comes later."""


@dataclass(frozen=True, slots=True)
class WarmUp:
    """What the begin of a run is like.

    Attributes:
        messages: how many to leave out by MSER-5.
        ratio: their level over that of the others (geometric means of batch medians); 2 is twice as slow.
        p_value: of a difference like this between a begin of that length and the rest, two-sided.
    """

    messages: int
    ratio: float
    p_value: float

    def is_sure(self, at_least: float = 0.0) -> bool:
        """Return whether it is no chance, and the levels differ by at least this share."""
        apart = max(self.ratio, 1 / self.ratio) - 1
        return self.messages > 0 and self.p_value <= P_VALUE_TO_TELL and apart >= at_least


def find_warm_up(values: NDArray[Any]) -> WarmUp | None:
    """Return the warm-up of a run by MSER-5; None in less than `MESSAGES_TO_TELL` messages.

    The batches to leave out are those without which the standard error of the mean of the rest is smallest (K. P.
    White, "An effective truncation heuristic for bias reduction in simulation output", Simulation 69, 1997, with
    batches of five as in K. P. White, M. Cobb and S. Spratt, WSC 2000). Batches are medians of logarithms here: a mean
    is drawn by one late message to the place where that message is. At most a quarter of the run is left out. The
    heuristic always finds something, so it is tested: the begin has to be unlike from its first quarter on, unlike the
    rest more than any stretch of the rest of the same length, and (`is_sure`) by more than the variance of the rest,
    read from its slowest movements, explains.

    Args:
        values: one run in the order of time, above zero; lost messages left out.
    """
    if len(values) < MESSAGES_TO_TELL:
        return None
    count = len(values) // BATCH
    # The logarithm of a median is the median of the logarithms.
    batches = np.log(medians_of_five(values[: count * BATCH].reshape(count, BATCH)).astype(np.float64))
    left_out = mser_truncation(batches)
    if not left_out:
        return WarmUp(0, 1.0, 1.0)
    begin, rest = batches[:left_out], batches[left_out:]
    difference = float(begin.mean() - rest.mean())
    head = float(begin[: max(1, len(begin) // 4)].mean() - rest.mean())
    count = len(rest) // left_out
    windows = rest[: count * left_out].reshape(count, left_out).mean(axis=1) - rest.mean()
    if head / difference < HEAD_SHARE or abs(difference) <= np.abs(windows).max():
        return WarmUp(0, 1.0, 1.0)
    variance = max(float(rest.var(ddof=1)), long_run_variance(rest))
    error = math.sqrt(variance * (1 / len(begin) + 1 / len(rest)))
    t = abs(difference) / error if error else math.inf
    return WarmUp(left_out * BATCH, math.exp(difference), 2 * student_cdf(-t, COSINES))


def medians_of_five(batches: NDArray[Any]) -> NDArray[Any]:
    """Return the median of each row, shape (batches,); of rows this short numpy's takes five times as long.

    The median of the fifth value, the larger of the two least of two pairs, and the smaller of their two largest.

    Args:
        batches: shape (batches, 5).
    """
    a, b, c, d, e = batches.T
    low, high = np.maximum(np.minimum(a, b), np.minimum(c, d)), np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.asarray(np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e)))


def mser_truncation(series: Float64) -> int:
    """Return how many values at the begin to leave out: the d that makes `sum (x - mean)^2 / (n - d)^2` smallest.

    The sum and the mean are those of what is left; d is at most a quarter of the series.

    Args:
        series: float64 in the order of time, shape (values,).
    """
    n = len(series)
    centred = series - series.mean()
    left = np.arange(n, 0, -1)
    sums = np.cumsum(centred[::-1])[::-1]
    squares = np.cumsum(np.square(centred)[::-1])[::-1]
    about_mean = squares - sums * sums / left
    # A rest of equal values has nothing left but the rounding of the sums, whose least is anywhere.
    about_mean[about_mean <= n * np.finfo(np.float64).eps * squares[0]] = 0
    criterion = about_mean / (left * left)
    return int(np.argmin(criterion[: n // 4 + 1]))
