"""Histograms of log-linear buckets, which merge by addition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
