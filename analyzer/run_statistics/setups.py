"""Which setups differ, from the statistics of their runs with several kinds of message: pooled Welch tests.

The logarithm of a run's statistic is `x[k, c, i]` of kind of message k, setup c and repeat i. From P repeats, a spread
is known with P - 1 degrees of freedom. Where the spreads of the kinds are alike by Bartlett's test (1937), a setup has
one spread, the mean of the kinds' variances, with `(P - 1) (tr S)^2 / tr(S^2)` degrees (S the covariance of the kinds
over the repeats; F. E. Satterthwaite, Biometrics Bulletin 2, 1946): with one relay for all sizes these move together
and count as one. A kind that spreads more than the others by an F test keeps its own. Rates, true and
false: docs/explanation/statistics.md.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from string import ascii_letters

import numpy as np
from numpy.typing import NDArray

from ..statistics.distributions import chi_square_cdf, incomplete_beta
from .two_samples import StudentTest

Float64 = NDArray[np.float64]
Key = tuple[Hashable, str]
"""Kind of message and setup."""


ALIKE_FROM = 0.2
"""P value from which on spreads are pooled: high, as few repeats hide unlike spreads."""

MORE_UP_TO = 0.05
"""P value of an F test up to which one kind of message keeps its own spread."""


@dataclass(frozen=True, slots=True, eq=False)
class RunLogarithms:
    """The logarithms of the statistics of one setup's runs with one kind of message.

    Attributes:
        values: float64, in the order of the repeats.
        repeats: the repeats; setups' spreads are pooled over kinds with equal ones.
    """

    values: Float64
    repeats: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class SetupMean:
    """The mean of a setup's logarithms, the variance of this mean, and the degrees of freedom of the variance."""

    mean: float
    variance: float
    degrees: float

    def against(self, other: SetupMean) -> StudentTest:
        total = self.variance + other.variance
        weights = self.variance**2 / self.degrees + other.variance**2 / other.degrees
        degrees = total**2 / weights if weights else self.degrees + other.degrees
        errors = float(np.sqrt(self.variance)), float(np.sqrt(other.variance))
        return StudentTest(other.mean - self.mean, *errors, degrees, 0)


def setup_means(runs: Mapping[Key, RunLogarithms]) -> dict[Key, SetupMean]:
    """Return the mean of every setup with every kind of message, its spread pooled over the kinds where they are alike."""
    pools: dict[Hashable, list[Key]] = defaultdict(list)
    for (kind, setup), own in runs.items():
        pools[setup, own.repeats].append((kind, setup))
    residuals = {
        pool: np.array([runs[key].values - runs[key].values.mean() for key in keys]) for pool, keys in pools.items()
    }
    is_pooled = spreads_are_alike(residuals.values())
    means: dict[Key, SetupMean] = {}
    for pool, keys in pools.items():
        rows = residuals[pool]
        pooled = pooled_variance(rows)
        for index, (key, row) in enumerate(zip(keys, rows, strict=True)):
            has_own = not is_pooled or spreads_more(rows, index)
            variance, degrees = pooled_variance(row[np.newaxis]) if has_own else pooled
            means[key] = SetupMean(float(runs[key].values.mean()), variance / len(row), degrees)
    return means


def pooled_variance(residuals: Float64) -> tuple[float, float]:
    """Return the variance of a run and its effective degrees of freedom; `residuals` has shape (kinds, repeats)."""
    kinds, repeats = residuals.shape
    gram = residuals.T @ residuals / (repeats - 1)
    trace, square_sum = float(np.trace(gram)), float(np.square(gram).sum())
    degrees = (repeats - 1) * (trace**2 / square_sum if square_sum else 1.0)
    return trace / kinds, degrees


def spreads_are_alike(residuals: Iterable[Float64]) -> bool:
    """Return whether no setup has unlike spreads over the kinds: Bartlett's statistic within each, summed."""
    statistic, freedom = 0.0, 0
    for own in residuals:
        kinds, repeats = own.shape
        if kinds < 2:
            continue
        variances = np.square(own).sum(axis=1) / (repeats - 1)
        if not variances.all():  # runs that are equal to the digit are not of the others' spread
            return not variances.any()
        correction = 1 + (kinds + 1) / (3 * kinds * (repeats - 1))
        unlike = kinds * np.log(variances.mean()) - np.log(variances).sum()
        statistic += (repeats - 1) * float(unlike) / correction
        freedom += kinds - 1
    return not freedom or 1 - chi_square_cdf(statistic, freedom) >= ALIKE_FROM


def spreads_more(residuals: Float64, index: int) -> bool:
    """Return whether one kind of message spreads more than the others, by an F test: few repeats hide one noisy kind from Bartlett's."""
    if len(residuals) < 2:
        return False
    (own, degrees), (others, others_degrees) = (
        pooled_variance(part) for part in (residuals[index : index + 1], np.delete(residuals, index, axis=0))
    )
    share = others * others_degrees / (others * others_degrees + own * degrees) if own else 1.0
    return incomplete_beta(share, others_degrees / 2, degrees / 2) <= MORE_UP_TO


def tier_letters(names: Sequence[str], different: Collection[tuple[str, str]]) -> dict[str, str]:
    """Return the letters of each name: two names share one exactly if they do not differ.

    Insert and absorb (H.-P. Piepho, Journal of Computational and Graphical Statistics 13, 2004). `a` has the first name.
    """
    tiers = [frozenset(names)]
    for one, other in combinations(names, 2):
        if (one, other) not in different and (other, one) not in different:
            continue
        split = [
            part for tier in tiers for part in ((tier - {one}, tier - {other}) if {one, other} <= tier else (tier,))
        ]
        unique = list(dict.fromkeys(split))
        tiers = [tier for tier in unique if not any(tier < larger for larger in unique)]
    index = {name: number for number, name in enumerate(names)}
    tiers.sort(key=lambda tier: sorted(index[name] for name in tier))
    return {name: "".join(_letter(number) for number, tier in enumerate(tiers) if name in tier) for name in names}


def _letter(number: int) -> str:
    return ascii_letters[number] if number < len(ascii_letters) else chr(0x100 + number)


def overlap_in_time(one: Sequence[int], other: Sequence[int]) -> bool:
    """Return whether runs of two setups were mixed in time, by their starts: else a drift looks like a difference.

    Mixed: a run of one started before a run of the other in 10 to 90 % of all pairs of runs; at once is half before.
    """
    if not (len(one) and len(other)):
        return True
    later = np.subtract.outer(np.array(other), np.array(one))
    before = float((1 + np.sign(later)).mean()) / 2
    return LEAST_MIXED <= before <= 1 - LEAST_MIXED


LEAST_MIXED = 0.1
"""Share of pairs of runs in the rarer order; alternating setups have 0.24 or more."""
