"""Where the tail of a sample begins, and which values are in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Values = NDArray[Any]  # int64 or float64


@dataclass(frozen=True, slots=True)
class Threshold:
    """Where a tail begins.

    Attributes:
        value: the order statistic next to the quantile, on the side of the bulk.
        is_upper: whether the tail is above it (quantiles from p50 on) or below.
        is_part: whether messages equal to the value are part of the tail.
    """

    value: float
    is_upper: bool
    is_part: bool

    def is_beyond(self, values: Values) -> NDArray[np.bool_]:
        """Return which values are in the tail; beyond an infinite threshold, the lost messages."""
        if math.isinf(self.value):
            return values >= self.value
        if self.is_upper:
            return values >= (self.value if self.is_part else math.nextafter(self.value, math.inf))
        return values <= self.value if self.is_part else values < self.value


def thresholds_of(ordered: Values, quantiles: Sequence[float]) -> list[Threshold]:
    """Return the threshold of each quantile.

    A clock with a tick of a millisecond makes many values equal: those at the quantile are part of the tail if that brings
    its share closer to what the quantile leaves beyond, and if the tail is empty without them.

    Args:
        ordered: the values, ascending, at least one.
        quantiles: between 0 and 1, both excluded.
    """
    last = len(ordered) - 1
    values = ordered[[math.floor(last * q) if q >= 0.5 else math.ceil(last * q) for q in quantiles]]
    below, after = (ordered.searchsorted(values, side).tolist() for side in ("left", "right"))
    return [
        _threshold(value, quantile, len(ordered), less, no_more)
        for value, quantile, less, no_more in zip(values.tolist(), quantiles, below, after, strict=True)
    ]


def _threshold(value: float, quantile: float, messages: int, less: int, no_more: int) -> Threshold:
    """Return the threshold at an order statistic: `less` values are below it, `no_more` are not above."""
    is_upper = quantile >= 0.5
    if math.isinf(value):
        return Threshold(float(value), is_upper, is_part=False)
    counts = (messages - no_more, messages - less) if is_upper else (less, no_more)
    expected = messages * (1 - quantile if is_upper else quantile)
    misfits = [(count in {0, messages}, abs(count - expected)) for count in counts]
    return Threshold(float(value), is_upper, is_part=misfits[1] < misfits[0])


def indices_beyond(
    values: Values,
    offsets: NDArray[np.intp],
    thresholds: Sequence[Sequence[Threshold]],
    quantiles: Sequence[float],
) -> list[NDArray[np.intp]]:
    """Return for each quantile the indices of the values that are beyond the threshold of their series.

    An upper tail is searched in the next wider one by its indices: numpy takes five times as long to select by a mask.

    Args:
        values: of the first series, then of the second ...; shape (values,).
        offsets: the first value of each series and the number of all, shape (series + 1,).
        thresholds: of each series one for each quantile.
        quantiles: between 0 and 1, both excluded.
    """
    indices: dict[float, NDArray[np.intp]] = {}
    wider, rest, ends = None, values, offsets
    by_quantile = zip(quantiles, zip(*thresholds, strict=True), strict=True)
    for quantile, by_series in sorted(by_quantile, key=itemgetter(0)):
        spans = pairwise(ends.tolist())
        parts = [one.is_beyond(rest[start:end]) for one, (start, end) in zip(by_series, spans, strict=True)]
        inside = np.concatenate(parts).nonzero()[0]
        indices[quantile] = inside if wider is None else wider[inside]
        if by_series[0].is_upper:
            wider, rest = indices[quantile], rest[inside]
            ends = wider.searchsorted(offsets)
    return [indices[quantile] for quantile in quantiles]
