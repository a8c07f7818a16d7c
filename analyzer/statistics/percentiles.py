"""Percentiles and other statistics: which ones exist, how they are computed, how many messages they take.

A two-sided interval of the q-quantile exists once the sample is unlikely to be wholly on one side of it:
`q**n <= (1 - confidence) / 2`, the same for `1 - q` (H. A. David and H. N. Nagaraja, "Order Statistics", 2003, section 7.1).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .distributions import special


@lru_cache(maxsize=4096)
def order_statistic_ranks(n: int, quantile: float, confidence: float = 0.95) -> tuple[int | None, int | None]:
    """Return the ranks (1-based) of the values that enclose a quantile of n independent ones; None outside the sample.

    Each end misses the quantile with probability at most `a = (1 - confidence) / 2`: the lower is the largest rank l with
    `P(B < l) <= a`, the upper the smallest rank u with `P(B >= u) <= a`, where B is binomial(n, quantile).
    """
    tail = (1 - confidence) / 2
    lower = bisect_right(range(n + 1), tail, key=lambda k: special().bdtr(k, n, quantile))
    # As many of the others, from the top on, so that a small probability is not the difference of two large ones.
    upper = 1 + n - bisect_right(range(n + 1), tail, key=lambda k: special().bdtr(k, n, 1 - quantile))
    return lower if lower >= 1 else None, upper if upper <= n else None


Values = NDArray[np.int64 | np.float64]
"""In float64 a lost message may be infinity."""


@lru_cache(maxsize=256)
def minimum_messages(quantile: float) -> int:
    """Return the least sample of an estimate: one over the share beyond, 100 for p99."""
    _check(quantile, 0.5)
    if quantile <= 0.5:
        return 1
    beyond = 1 - Fraction(str(quantile))  # exact: 1 / (1 - 0.9) is 10.000000000000002 in floats
    return math.ceil(1 / beyond)


def planned_messages(quantile: float, confidence: float = 0.95, inflation: float = 1.0) -> int:
    """Return the least messages of a two-sided interval; `inflation` of them count as one."""
    _check(quantile, confidence)
    independent = math.log((1 - confidence) / 2) / math.log(max(quantile, 1 - quantile))
    return math.ceil(round(independent * max(inflation, 1.0), 9))


def _check(quantile: float, confidence: float) -> None:
    if not 0 < quantile < 1 or not 0 < confidence < 1:
        raise ValueError("quantile and confidence lie between 0 and 1, both excluded")


@dataclass(frozen=True, slots=True)
class Percentile:
    name: str
    quantile: float
    needs: int

    @property
    def label(self) -> str:
        return self.name.replace("_", ".")

    @property
    def is_decade(self) -> bool:
        """Whether it is of the series p50, p90, p99, p99.9, each ten times as rare as the preceding; p95 is not."""
        return math.log10(self.needs).is_integer()


PERCENTILES = tuple(
    Percentile(name, quantile, minimum_messages(quantile))
    for name, quantile in (("p50", 0.50), ("p90", 0.90), ("p95", 0.95), ("p99", 0.99), ("p99_9", 0.999))
)


def quantile_of(ordered: Values, quantile: float) -> float:
    """Return a quantile (Hyndman and Fan, 1996: definition 7) of ascending values, infinite if an order statistic is."""
    position = quantile * (len(ordered) - 1)
    below = math.floor(position)
    low, high = float(ordered[below]), float(ordered[min(below + 1, len(ordered) - 1)])
    share = position - below
    return low if share == 0 or low == high else low + (high - low) * share


MANTISSA_BITS = 10
"""Exponent and first mantissa bits of a float64 number `2**MANTISSA_BITS` steps an octave, as in HdrHistogram."""

RELATIVE_ERROR = 2.0 ** -(MANTISSA_BITS + 1)
"""Largest error of a value, as a share of it: half a bucket, 0.05 %."""

_SHIFT = 52 - MANTISSA_BITS
_BUCKET_OF_ONE = 1023 << MANTISSA_BITS


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Counts by the ascending centres of buckets that are not empty."""

    value_ns: NDArray[np.float64]
    count: NDArray[np.uint64]


def histogram_of(ordered_ns: NDArray[np.int64]) -> Histogram:
    """Count ascending values; negative ones (a clock fault) mirror positive ones."""
    zero, positive = np.searchsorted(ordered_ns, [0, 1]).tolist()
    below = _positive_histogram(-ordered_ns[:zero][::-1])
    above = _positive_histogram(ordered_ns[positive:])
    zeros = [positive - zero] if positive > zero else []
    return Histogram(
        np.concatenate([-below.value_ns[::-1], np.zeros(len(zeros)), above.value_ns]),
        np.concatenate([below.count[::-1], np.array(zeros, np.uint64), above.count]),
    )


def _positive_histogram(ordered_ns: NDArray[np.int64]) -> Histogram:
    if not len(ordered_ns):
        return Histogram(np.empty(0), np.empty(0, np.uint64))
    buckets = ordered_ns.astype(np.float64).view(np.int64)
    buckets >>= _SHIFT
    first = np.append(0, np.flatnonzero(buckets[1:] != buckets[:-1]) + 1)
    count = np.diff(first, append=len(buckets)).astype(np.uint64)
    filled = buckets[first] - _BUCKET_OF_ONE
    octave = np.ldexp(1.0, filled >> MANTISSA_BITS)
    width = octave / (1 << MANTISSA_BITS)
    low = octave + width * (filled & ((1 << MANTISSA_BITS) - 1))
    # A bucket narrower than 1 holds the one integer at its lower end.
    return Histogram(np.asarray(low + np.maximum(width - 1, 0) / 2, np.float64), count)


def histogram_quantile(histogram: Histogram, quantile: float) -> float:
    cumulative = np.cumsum(histogram.count.astype(np.int64))
    last = int(cumulative[-1]) - 1
    position = quantile * last
    below = int(position)
    low, high = (
        float(histogram.value_ns[np.searchsorted(cumulative, min(rank, last), side="right")])
        for rank in (below, below + 1)
    )
    return low + (high - low) * (position - below)


@dataclass(frozen=True, slots=True, eq=False)
class Sketch:
    """What remains of the values of a group in parts, one at least: exact moments, and a histogram."""

    samples: int
    mean: float
    std: float | None
    min: float
    max: float
    histogram: Histogram

    def quantile(self, quantile: float) -> float:
        """Return a quantile within the values; a bucket's centre may be outside."""
        return min(max(histogram_quantile(self.histogram, quantile), self.min), self.max)


@dataclass(frozen=True, slots=True)
class GroupStatistic:
    """A statistic of the values of a group, from `needs` values on.

    Attributes:
        name: in columns.
        label: in menus and of one-way times; empty where neither has it.
        of_values: from ascending values in ns.
        of_sketch: the same within the error of the histogram.
        needs: least number of values.
        is_tabled: whether the tables of results have it.
    """

    name: str
    label: str
    of_values: Callable[[NDArray[np.int64]], float]
    of_sketch: Callable[[Sketch], float | None]
    needs: int = 1
    is_tabled: bool = False


def _std(ordered_ns: NDArray[np.int64]) -> float:
    apart = ordered_ns - ordered_ns.mean()
    return math.sqrt(float(np.square(apart, out=apart).sum()) / (len(ordered_ns) - 1))


def _of_percentile(percentile: Percentile) -> GroupStatistic:
    name, quantile = percentile.name, percentile.quantile
    return GroupStatistic(
        name,
        "median" if quantile == 0.5 else percentile.label,
        lambda ordered_ns: quantile_of(ordered_ns, quantile),
        lambda sketch: sketch.quantile(quantile),
        percentile.needs,
        is_tabled=percentile.is_decade and percentile.needs <= 100,
    )


STATISTICS = (
    GroupStatistic("mean", "mean", lambda ordered_ns: float(ordered_ns.mean()), lambda sketch: sketch.mean),
    GroupStatistic("std", "", _std, lambda sketch: sketch.std, needs=2),
    GroupStatistic("min", "minimum", lambda ordered_ns: float(ordered_ns[0]), lambda sketch: sketch.min),
    *map(_of_percentile, PERCENTILES),
    GroupStatistic(
        "max", "maximum", lambda ordered_ns: float(ordered_ns[-1]), lambda sketch: sketch.max, is_tabled=True
    ),
)
"""In the order of the columns `<metric>_<name>_ns`."""


def summarize_values(ordered_ns: NDArray[np.int64]) -> dict[str, float | None]:
    n = len(ordered_ns)
    return {row.name: row.of_values(ordered_ns) if n >= row.needs else None for row in STATISTICS}


def summarize_sketch(sketch: Sketch) -> dict[str, float | None]:
    return {row.name: row.of_sketch(sketch) if sketch.samples >= row.needs else None for row in STATISTICS}
