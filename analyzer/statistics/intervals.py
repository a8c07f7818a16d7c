"""Confidence intervals of percentiles by order statistics, and of the share of messages that arrived.

Order statistics: of n independent values, the number below the q-quantile is binomial(n, q) whatever the
distribution, so two of the sorted values enclose the quantile with a probability that can be computed (H. A.
David and H. N. Nagaraja, "Order Statistics", 3rd ed. 2003, section 7.1).

Messages are not independent. How much that matters for a quantile is in the series "below it or not": its variance
inflation says how many messages count as one (`dependence_of`).

An end of an interval that the sample cannot support is None, never the sample's extreme in disguise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from .dependence import Float64, dependence_of
from .percentiles import Values, minimum_messages, quantile_of

if TYPE_CHECKING:
    from numpy.typing import NDArray


Range = tuple[float | None, float | None]
"""Lower and upper end; an end that is None excludes nothing."""


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate with its confidence interval; a value that the sample does not support is None.

    Attributes:
        value: the estimate.
        lower: lower end.
        upper: upper end.
        confidence: probability that an interval with both ends holds the truth.
        samples: values in the sample.
        independent: number of independent values that the sample is worth.
    """

    value: float | None
    lower: float | None
    upper: float | None
    confidence: float
    samples: int
    independent: int

    @property
    def is_two_sided(self) -> bool:
        """Whether both ends are known."""
        return self.lower is not None and self.upper is not None

    @property
    def range(self) -> Range:
        """Both ends."""
        return self.lower, self.upper


def ranges_overlap(one: Range, other: Range) -> bool:
    """Tell whether two ranges have a value in common."""
    low = max(-math.inf if lower is None else lower for lower, _ in (one, other))
    high = min(math.inf if upper is None else upper for _, upper in (one, other))
    return low <= high


def percentile_interval(
    values: Values, quantile: float, confidence: float = 0.95, *, ordered: Values | None = None
) -> Interval:
    """Return a quantile of a series with its confidence interval by order statistics.

    The ranks are those for as many independent values as the series is worth, stretched to its length. Simulated
    with autoregressive series (correlation of neighbours 0, 0.5 and 0.8; p50 to p99; 150 to 10,000 messages),
    a 95 % interval holds the true quantile in 90 to 99 of 100 series. It is too narrow where neighbours are nearly
    equal and the series short: with correlation 0.95, p90 of 150 messages is held by 64 of 100, p95 of 1000 by 93.

    Args:
        values: the series in the order of time, so that neighbours are neighbours; infinity for a lost message.
        quantile: between 0 and 1, both excluded.
        confidence: between 0 and 1, both excluded.
        ordered: the same values in rising order, if the caller has them.
    """
    n = len(values)
    if n < minimum_messages(quantile):
        return Interval(None, None, None, confidence, n, n)
    ordered = np.sort(values) if ordered is None else ordered
    inflation = dependence_of(values <= ordered[_rank(n, quantile) - 1]).inflation
    independent = max(1, int(n / inflation))
    lower, upper = order_statistic_ranks(independent, quantile, confidence)
    stretch = n / independent
    return Interval(
        value=quantile_of(ordered, quantile),
        lower=None if lower is None else float(ordered[math.floor((lower - 1) * stretch)]),
        upper=None if upper is None else float(ordered[math.ceil(round(upper * stretch, 6)) - 1]),
        confidence=confidence,
        samples=n,
        independent=independent,
    )


def ratio_interval(happened: NDArray[np.bool_], confidence: float = 0.95) -> Interval:
    """Return the share of True in a series with its confidence interval (E. B. Wilson, 1927).

    Losses come in bursts, so the series counts for as many independent messages as it is worth; a series that
    is all True or all False shows no bursts and counts in full.

    Args:
        happened: bool, in the order of time.
        confidence: between 0 and 1, both excluded.
    """
    n = len(happened)
    if not n:
        return Interval(None, None, None, confidence, 0, 0)
    share = float(happened.mean())
    independent = max(1, int(n / dependence_of(happened).inflation))
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    centre = share + z * z / (2 * independent)
    reach = z * math.sqrt(share * (1 - share) / independent + z * z / (4 * independent**2))
    scale = 1 + z * z / independent
    lower = 0.0 if share == 0 else (centre - reach) / scale
    upper = 1.0 if share == 1 else (centre + reach) / scale
    return Interval(share, lower, upper, confidence, n, independent)


def _rank(n: int, quantile: float) -> int:
    """Return the 1-based rank of the smallest value that at least `quantile` of the sample does not exceed."""
    return min(max(math.ceil(round(n * quantile, 9)), 1), n)


@lru_cache(maxsize=4096)
def order_statistic_ranks(n: int, quantile: float, confidence: float = 0.95) -> tuple[int | None, int | None]:
    """Return the ranks (1-based) of the two sorted values that enclose a quantile of n independent ones.

    Each end misses the quantile with probability at most `a = (1 - confidence) / 2`: the lower is the largest rank l
    with `P(B < l) <= a`, the upper the smallest rank u with `P(B >= u) <= a`, where B is binomial(n, quantile). A rank
    that the sample does not have is None.
    """
    tail = (1 - confidence) / 2
    first, below = _binomial_cdf(n, quantile)
    lower = first + int(np.searchsorted(below, tail, side="right"))  # the first k with P(B <= k) > a
    above = 1 - below  # P(B >= k + 1)
    upper = first + 1 + int(np.argmax(above <= tail))
    return lower if lower >= 1 else None, upper if upper <= n else None


def _binomial_cdf(n: int, p: float) -> tuple[int, Float64]:
    """Return the first k that is computed, and `P(B <= k)` from there on; the rest has a probability under 1e-20.

    The probability of the mean is taken from log-gamma, its neighbours from the ratio of consecutive terms.
    """
    reach = math.ceil(12 * math.sqrt(n * p * (1 - p))) + 60
    middle = round(n * p)
    first, last = max(0, middle - reach), min(n, middle + reach)
    k = np.arange(first, last)
    step = np.log((n - k) / (k + 1) * (p / (1 - p)))  # log of P(k + 1) / P(k)
    log_pmf = np.concatenate([[0.0], np.cumsum(step)])
    log_pmf += (
        math.lgamma(n + 1)
        - math.lgamma(middle + 1)
        - math.lgamma(n - middle + 1)
        + middle * math.log(p)
        + (n - middle) * math.log1p(-p)
        - log_pmf[middle - first]
    )
    return first, np.cumsum(np.exp(log_pmf))
