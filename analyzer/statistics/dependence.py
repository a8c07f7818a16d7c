"""How alike neighbours of a series are: how many messages count as one independent message.

Messages are not independent: one that waits in a queue makes the next one wait. The correlation of neighbours gives
the length of the blocks that a bootstrap must keep together, and the factor by which a sample is worth less than its
size (D. Politis and H. White, "Automatic block-length selection for the dependent bootstrap", Econometric Reviews 23,
2004, corrected by A. Patton and the same, Econometric Reviews 28, 2009).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .percentiles import Values

Float64 = NDArray[np.float64]

_PIECE = 8192
"""Values that one scalar product takes: too few for BLAS to wake its threads, which wait for each other on busy cores."""

_LONGEST_LAG = 1000
"""Neighbours farther apart than this count as independent."""

_FEWEST_VALUES = 10
"""Values below which a series shows no correlation."""


@dataclass(frozen=True, slots=True)
class Dependence:
    """How alike neighbours of a series are.

    Attributes:
        block_messages: neighbours that a bootstrap keeps together, 1 if they are independent.
        inflation: variance of the mean divided by that of independent values, at least 1: the number of messages that
            count as one.
    """

    block_messages: int
    inflation: float


_INDEPENDENT = Dependence(block_messages=1, inflation=1.0)


def dependence_of(series: Values | NDArray[np.bool_]) -> Dependence:
    """Return block length and variance inflation of a series in the order of time.

    Politis and White 2004, section 3, with Patton's correction, for the circular block bootstrap: correlations count
    up to the lag after which K in a row are within `2 sqrt(log10(n) / n)`, with K = max(5, sqrt(log10(n))).
    """
    n = len(series)
    centred = series.astype(np.float64) - series.mean() if n else np.empty(0)
    variance = _product(centred, centred) / n if n else 0.0
    if n < _FEWEST_VALUES or variance == 0:
        return _INDEPENDENT
    small = 2 * math.sqrt(math.log10(n) / n)
    in_a_row = max(5, math.ceil(math.sqrt(math.log10(n))))
    longest = min(math.ceil(math.sqrt(n)) + in_a_row, n - 1, _LONGEST_LAG)
    covariance = [variance]
    last_large = 0
    for lag in range(1, longest + 1):
        covariance.append(_product(centred[:-lag], centred[lag:]) / n)
        if abs(covariance[lag]) >= small * variance:
            last_large = lag
        elif lag - last_large >= in_a_row:
            break
    if last_large == 0:
        return _INDEPENDENT
    window = min(2 * last_large, longest)
    while len(covariance) <= window:
        lag = len(covariance)
        covariance.append(_product(centred[:-lag], centred[lag:]) / n)
    lags = np.arange(1, window + 1)
    flat_top = np.minimum(1.0, 2 * (1 - lags / window))
    weighted = flat_top * np.array(covariance[1 : window + 1])
    spectrum = variance + 2 * float(weighted.sum())  # g(0): n times the variance of the mean
    slope = 2 * float((lags * weighted).sum())  # G
    if spectrum <= variance:  # alternating neighbours make a mean better; the analysis does not rely on that
        return _INDEPENDENT
    block = (2 * slope**2 / (4 / 3 * spectrum**2)) ** (1 / 3) * n ** (1 / 3)
    most = math.ceil(min(3 * math.sqrt(n), n / 3))
    return Dependence(max(2, min(math.ceil(block), most)), spectrum / variance)


def _product(one: Float64, other: Float64) -> float:
    """Return the scalar product, summed over pieces of `_PIECE` values."""
    pieces = range(0, len(one), _PIECE)
    return float(sum(one[first : first + _PIECE] @ other[first : first + _PIECE] for first in pieces))
