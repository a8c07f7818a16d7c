"""The ranks of the sorted values that enclose a quantile.

Of n independent values the number below the q-quantile is binomial(n, q) whatever the distribution, so two of the
sorted values enclose the quantile with a probability that can be computed (H. A. David and H. N. Nagaraja, "Order
Statistics", 3rd ed. 2003, section 7.1).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]


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
