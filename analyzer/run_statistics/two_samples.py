"""Tests of a difference of two means, and intervals of a difference and a ratio."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..statistics.distributions import student_cdf, student_quantile
from .bursts import Float64

Ends = tuple[float, float, float]
"""An estimate, its lower and its upper end."""


@dataclass(frozen=True, slots=True)
class StudentTest:
    """A difference (new - base) of two means with what Student's t needs; `pairs` is 0 for independent samples."""

    difference: float
    base_error: float
    new_error: float
    degrees: float
    pairs: int

    @property
    def error(self) -> float:
        return math.hypot(self.base_error, self.new_error)

    @property
    def p_value(self) -> float:
        if self.error == 0:
            return 1.0 if self.difference == 0 else 0.0
        return 2 * student_cdf(-abs(self.difference) / self.error, self.degrees)

    def reach(self, confidence: float) -> float:
        return student_quantile((1 + confidence) / 2, self.degrees)


def welch(difference: float, variances: Sequence[float], degrees: Sequence[float]) -> StudentTest:
    """Return the test of two means by the variance of each and its degrees of freedom (B. L. Welch, Biometrika 34, 1947)."""
    weights = sum(variance**2 / freedom for variance, freedom in zip(variances, degrees, strict=True))
    base_error, new_error = map(math.sqrt, variances)
    return StudentTest(difference, base_error, new_error, sum(variances) ** 2 / weights if weights else sum(degrees), 0)


def welch_test(base: Float64, new: Float64, least_variance: float = 0.0) -> StudentTest:
    """Return `welch` of two samples; a value has at least `least_variance`, as samples may be equal by chance."""
    variances = [max(float(side.var(ddof=1)), least_variance) / len(side) for side in (base, new)]
    return welch(float(new.mean() - base.mean()), variances, [len(side) - 1 for side in (base, new)])


def paired_test(base: Float64, new: Float64, least_variance: float = 0.0) -> StudentTest:
    """Return the test of the differences of pairs (Student, 1908); `least_variance` is a lower bound of the variance of one."""
    apart = new - base
    error = math.sqrt(max(float(apart.var(ddof=1)), least_variance) / (2 * len(apart)))
    return StudentTest(float(apart.mean()), error, error, len(apart) - 1, len(apart))


MOST_PERMUTATIONS = 20_000
"""Ways to deal the values of two samples that are counted; more of them leave Welch's test as it is."""


def permutation_p_value(base: Float64, new: Float64) -> float:
    """Return the share of the ways to deal the values in which the means differ as much (R. A. Fisher, 1935); 0 if they are too many.

    Of zeros and ones this is Fisher's exact test.
    """
    values = np.concatenate([base, new])
    if math.comb(len(values), len(base)) > MOST_PERMUTATIONS:
        return 0.0
    dealt = np.array(list(itertools.combinations(range(len(values)), len(base))))
    # The difference of the means follows from the sum of one side.
    apart = np.abs(values[dealt].sum(axis=1) - values.sum() * len(base) / len(values))
    return float((apart >= apart[0] * (1 - 1e-9)).mean())


def mover_ends(base: Ends, new: Ends) -> tuple[float, float]:
    """Return the ends of new - base from estimate and ends of both (G. Zou and A. Donner, Statistics in Medicine 27, 2008).

    `difference -+ sqrt((new - its end)^2 + (base - its opposite end)^2)`.
    """
    difference = new[0] - base[0]
    low = difference - math.hypot(new[0] - new[1], base[2] - base[0])
    return low, difference + math.hypot(new[2] - new[0], base[0] - base[1])


def fieller_ends(above: Float64, below: Float64, test: StudentTest, confidence: float) -> tuple[float, float]:
    """Return the ends of the ratio of two means that are not below zero (E. C. Fieller, JRSS B 16, 1954).

    The ratios r for which the means of `above` and `r below` do not differ significantly: the two roots of
    `(m^2 - t^2 v) r^2 - 2 M m r + M^2 - t^2 V = 0`, with M, V the mean of `above` and its variance, m, v of `below`. The lower end
    is 0 where `above` is not surely above zero, the upper infinite where `below` is not.
    """
    squared = test.reach(confidence) ** 2
    top, bottom = float(above.mean()), float(below.mean())
    a = bottom**2 - squared * float(below.var(ddof=1)) / len(below)
    c = top**2 - squared * float(above.var(ddof=1)) / len(above)
    root = math.sqrt(max(0.0, (top * bottom) ** 2 - a * c))
    high = (top * bottom + root) / a if a > 0 else math.inf
    if c <= 0:
        return 0.0, high
    return (c / (top * bottom + root) if bottom > 0 else math.inf), high
