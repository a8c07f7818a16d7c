"""Where the tail of a series begins, and which of its values lie beyond."""

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
    """Where the tail of a group begins.

    Attributes:
        value: the order statistic of all messages next to the quantile, on the side of the bulk.
        is_upper: whether the tail lies above it (quantiles from p50 on) or below.
        is_part: whether messages equal to the value are part of the tail.
    """

    value: float
    is_upper: bool
    is_part: bool

    @property
    def least(self) -> float:
        """The least value of an upper tail: the value itself if it is part of it or infinite, else the next number above."""
        return self.value if self.is_part else math.nextafter(self.value, math.inf)

    def is_beyond(self, values: Values) -> NDArray[np.bool_]:
        """Return which values lie in the tail.

        Where the value is infinite, the lost messages do: more of them than the quantile leaves room for, but
        comparing with infinity as with a number would make a series of lost and received ones look constant.
        """
        if self.is_upper or math.isinf(self.value):
            return values >= self.least
        return values <= self.value if self.is_part else values < self.value


def thresholds_of(ordered: Values, quantiles: Sequence[float]) -> list[Threshold]:
    """Return where the tails of a series begin.

    Of a clock that ticks once a millisecond many values are equal: those at the quantile are part of the tail if that
    brings its share closer to the one that the quantile leaves, and if no others are.

    Args:
        ordered: its values, rising, at least one.
        quantiles: between 0 and 1, both excluded.
    """
    messages = len(ordered)
    positions = [(messages - 1) * quantile for quantile in quantiles]
    values = ordered[
        [
            math.floor(position) if quantile >= 0.5 else math.ceil(position)
            for position, quantile in zip(positions, quantiles, strict=True)
        ]
    ]
    below, after = (ordered.searchsorted(values, side).tolist() for side in ("left", "right"))
    return [
        _threshold(value, quantile, messages, of_less, of_no_more)
        for value, quantile, of_less, of_no_more in zip(values.tolist(), quantiles, below, after, strict=True)
    ]


def _threshold(value: float, quantile: float, messages: int, below: int, after: int) -> Threshold:
    """Return the threshold at an order statistic that `below` values lie below, and `after` not above."""
    is_upper = quantile >= 0.5
    if math.isinf(value):
        return Threshold(float(value), is_upper, is_part=False)
    counts = (messages - after, messages - below) if is_upper else (below, after)
    wanted = messages * (1 - quantile if is_upper else quantile)
    misfits = [(count in {0, messages}, abs(count - wanted)) for count in counts]
    return Threshold(float(value), is_upper, is_part=misfits[1] < misfits[0])


def places_beyond(
    values: Values,
    edges: NDArray[np.intp],
    thresholds: Sequence[Sequence[Threshold]],
    quantiles: Sequence[float],
) -> list[NDArray[np.intp]]:
    """Return for each quantile where the values of some series, side by side, lie beyond its threshold.

    An upper tail is looked for in the next wider one, by the places that it has: numpy cuts an array by a mask that holds by
    chance five times slower.

    Args:
        values: of the first series, then of the second ...; shape (values,).
        edges: the first value of each series and the number of all, shape (series + 1,).
        thresholds: of each series one for each quantile.
        quantiles: between 0 and 1, both excluded.
    """
    found: dict[float, NDArray[np.intp]] = {}
    wider, rest, ends = None, values, edges
    of_quantiles = zip(quantiles, zip(*thresholds, strict=True), strict=True)
    for quantile, of_series in sorted(of_quantiles, key=itemgetter(0)):
        spans = pairwise(ends.tolist())
        parts = [one.is_beyond(rest[begin:end]) for one, (begin, end) in zip(of_series, spans, strict=True)]
        which = np.concatenate(parts).nonzero()[0]
        found[quantile] = which if wider is None else wider[which]
        if of_series[0].is_upper:
            wider, rest = found[quantile], rest[which]
            ends = wider.searchsorted(edges)
    return [found[quantile] for quantile in quantiles]
