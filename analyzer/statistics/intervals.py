"""Estimates with confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray


def mean_and_variance(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return `mean` and `var(ddof=1)` of two or more finite values, faster."""
    count = len(values)
    mean = np.add.reduce(values) / count
    apart = values - mean
    return float(mean), float(np.add.reduce(apart * apart) / (count - 1))


MIN_RUNS = 3
"""Least runs of an interval between runs: with two, Student's t is 12.7."""

MIN_EPISODES = 10
"""Episodes from which on their spread is estimated: of fewer it is uncertain by a factor of two."""

LEAST_BEYOND = 50
"""Expected messages beyond a quantile from which on one or two runs give it an end there."""

WIDEST_TAIL = 0.1
"""Share of the messages beyond a quantile below which they are a tail."""

Range = tuple[float | None, float | None]
"""Lower and upper end; None excludes nothing."""


class Basis(Enum):
    BETWEEN_RUNS = "between runs"  # holds for another run of the same kind
    WITHIN_RUN = "within one run"  # no verdict follows from it


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate with its interval; what the sample does not support is None.

    Attributes:
        lower: None where the interval is open.
        upper: likewise; infinite if lost messages reach up to it.
        confidence: probability that an interval with both ends contains the truth; one end is wrong with half of the rest.
        independent: independent messages that give this width within one run.
        units: runs, or groups of neighbouring runs, that the interval was computed from; 0 within one run.
        episodes: bursts of the messages beyond a quantile, as many of equal size as vary as much; of a received ratio those of
            losses (or of rarer replies). None for a mean, and where no value is beyond a quantile.
        unit_spread: standard deviation of the logarithms of the units; None within one run or without a finite logarithm.
    """

    value: float | None
    lower: float | None
    upper: float | None
    confidence: float
    samples: int
    independent: int
    basis: Basis
    runs: int
    units: int
    episodes: int | None
    unit_spread: float | None = None

    @property
    def is_two_sided(self) -> bool:
        return self.lower is not None and self.upper is not None

    @property
    def range(self) -> Range:
        return self.lower, self.upper


def ranges_overlap(first: Range, other: Range) -> bool:
    low = max(-math.inf if lower is None else lower for lower, _ in (first, other))
    high = min(math.inf if upper is None else upper for _, upper in (first, other))
    return low <= high


def without_open_end(interval: Interval, quantile: float | None) -> Interval:
    """Leave out the end beyond a tail of fewer than `LEAST_BEYOND` expected messages, whatever bursts are in it."""
    if quantile is None or interval.samples >= messages_to_end(quantile) or interval.lower == math.inf:
        return interval
    return replace(interval, upper=None) if quantile >= 0.5 else replace(interval, lower=None)


def messages_to_end(quantile: float) -> int:
    tail = tail_share(quantile)
    return math.ceil(round(LEAST_BEYOND / tail, 6)) if tail < WIDEST_TAIL else 1


def tail_share(quantile: float) -> float:
    return round(min(quantile, 1 - quantile), 9)
