"""Statistics of one metric of one group: exact percentiles with their sample support, moments, histograms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Percentile:
    """A percentile and the number of samples below which it is not given.

    With fewer samples than `1 / (1 - quantile)` the percentile interpolates towards the sample's maximum,
    which says nothing about a tail that the sample has not seen.
    """

    name: str
    quantile: float
    needs: int


PERCENTILES = (
    Percentile("p50", 0.50, 1),
    Percentile("p90", 0.90, 10),
    Percentile("p95", 0.95, 20),
    Percentile("p99", 0.99, 100),
    Percentile("p99_9", 0.999, 1000),
)


def summarize_values(values_ns: NDArray[np.int64]) -> dict[str, float | None]:
    """Mean, standard deviation, extremes and percentiles of one metric, None where the sample does not support it.

    Percentiles are exact: linear interpolation between order statistics (numpy's and polars' `linear`,
    Hyndman and Fan's definition 7). The standard deviation is the sample's (n - 1).

    Args:
        values_ns: the metric's values, rising.

    Returns:
        Statistic (`mean`, `std`, `min`, `p50` ... `max`) -> value in ns.
    """
    n = len(values_ns)
    supported = [p for p in PERCENTILES if n >= p.needs]
    found: dict[str, float | None] = {"mean": None, "std": None, "min": None, "max": None}
    found |= {p.name: None for p in PERCENTILES}
    if n:
        mean = values_ns.mean()
        found |= {"mean": float(mean), "min": float(values_ns[0]), "max": float(values_ns[-1])}
        found |= {p.name: _percentile(values_ns, p.quantile) for p in supported}
        if n > 1:  # numpy's `std`, which would take the mean again
            apart = values_ns - mean
            found["std"] = math.sqrt(float(np.square(apart, out=apart).sum()) / (n - 1))
    return found


def _percentile(ordered_ns: NDArray[np.int64], quantile: float) -> float:
    position = quantile * (len(ordered_ns) - 1)
    below = int(position)
    low, high = int(ordered_ns[below]), int(ordered_ns[min(below + 1, len(ordered_ns) - 1)])
    return low + (high - low) * (position - below)


# A float64's bits are its binary logarithm followed by its mantissa: the exponent and the first K mantissa bits
# number 2**K equal steps in every octave, which is the bucket of a log-linear histogram (HdrHistogram's layout)
# without a logarithm. Integers below 2**(K + 1) each have a bucket of their own.
K = 10
_SHIFT = 52 - K
_FIRST = 1023 << K  # the bucket of 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Counts of values in log-linear buckets; relative error of a value at most 0.05 % (half a bucket).

    Two histograms merge by addition of the counts of equal centres.

    Attributes:
        value_ns: float64, the buckets' centres, rising; empty buckets are left out.
        count: uint64, values in the bucket.
    """

    value_ns: NDArray[np.float64]
    count: NDArray[np.uint64]


def histogram_of(values_ns: NDArray[np.int64]) -> Histogram:
    """The histogram of rising values; those below zero (a clock fault) mirror those above."""
    zero, positive = np.searchsorted(values_ns, [0, 1]).tolist()
    below = _positive_histogram(-values_ns[:zero][::-1])
    above = _positive_histogram(values_ns[positive:])
    zeros = [positive - zero] if positive > zero else []
    return Histogram(
        np.concatenate([-below.value_ns[::-1], np.zeros(len(zeros)), above.value_ns]),
        np.concatenate([below.count[::-1], np.array(zeros, np.uint64), above.count]),
    )


def _positive_histogram(values_ns: NDArray[np.int64]) -> Histogram:
    """Of rising values, so that those of one bucket are neighbours."""
    if not len(values_ns):
        return Histogram(np.empty(0), np.empty(0, np.uint64))
    buckets = values_ns.astype(np.float64).view(np.int64)
    buckets >>= _SHIFT
    first = np.append(0, np.flatnonzero(buckets[1:] != buckets[:-1]) + 1)
    return Histogram(_centre(buckets[first] - _FIRST), np.diff(first, append=len(buckets)).astype(np.uint64))


def _centre(buckets: NDArray[np.int64]) -> NDArray[np.float64]:
    """The mean of the integers that fall into each bucket."""
    octave = np.ldexp(1.0, buckets >> K)
    width = octave / (1 << K)
    low = octave + width * (buckets & ((1 << K) - 1))
    # A bucket narrower than 1 holds the one integer at its lower end.
    return np.asarray(low + np.maximum(width - 1, 0) / 2, np.float64)
