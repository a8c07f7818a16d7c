"""Which setups differ, from the statistics of their runs with several kinds of message: pooled Welch tests.

The logarithm of a run's statistic is `x[k, c, i]` of kind of message k, setup c and repeat i of P. Where kinds share a spread
(docs/explanation/statistics.md), it is the mean of their variances with `(P - 1) (tr S)^2 / tr(S^2)` degrees of freedom (S the
covariance of the kinds over the repeats; F. E. Satterthwaite, Biometrics Bulletin 2, 1946): with one relay for all sizes these
move together and count as one.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from string import ascii_letters

import numpy as np

from ..statistics.distributions import special, student_cdf
from ..statistics.intervals import MIN_RUNS
from .bursts import Float64
from .two_samples import StudentTest, welch

Key = tuple[Hashable, str]
"""Kind of message and setup."""

ALIKE_FROM = 0.25
"""P value from which on spreads are pooled: high, as few repeats hide unlike spreads."""

MORE_UP_TO = 0.05
"""P value of an F test up to which one kind of message keeps its own spread."""

ENOUGH_RUNS = 5
"""Runs from which on a spread may be smaller than the campaign's."""

DEPENDENT_UP_TO, DEPENDENT_UP_TO_OF_ONE = 0.05, 0.01
"""P value up to which passes are taken to depend on each other, of several kinds of message and of one, where only long campaigns show it."""


@dataclass(frozen=True, slots=True, eq=False)
class RunLogarithms:
    values: Float64
    repeats: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class SetupMean:
    mean: float
    variance: float
    degrees: float

    def against(self, other: SetupMean) -> StudentTest:
        return welch(other.mean - self.mean, (self.variance, other.variance), (self.degrees, other.degrees))


def residuals_by_setup(runs: Mapping[Key, RunLogarithms]) -> dict[tuple[Hashable, ...], tuple[list[Key], Float64]]:
    pools: dict[tuple[Hashable, ...], list[Key]] = defaultdict(list)
    for (kind, setup), values in runs.items():
        pools[setup, values.repeats].append((kind, setup))
    return {
        pool: (keys, np.array([runs[key].values - runs[key].values.mean() for key in keys]))
        for pool, keys in pools.items()
    }


def setup_means(runs: Mapping[Key, RunLogarithms]) -> dict[Key, SetupMean]:
    pools = residuals_by_setup(runs)
    residuals = [rows for _, rows in pools.values()]
    is_pooled = spreads_are_alike(residuals)
    least = 0.0 if is_pooled else campaign_variance(residuals)
    means: dict[Key, SetupMean] = {}
    for keys, rows in pools.values():
        pooled = pooled_variance(rows)
        for index, (key, row) in enumerate(zip(keys, rows, strict=True)):
            has_own = not is_pooled or spreads_more(rows, index)
            variance, degrees = pooled_variance(row[np.newaxis]) if has_own else pooled
            if len(row) < ENOUGH_RUNS:
                variance = max(variance, least)
            means[key] = SetupMean(float(runs[key].values.mean()), variance / len(row), degrees)
    return means


def campaign_variance(residuals: Iterable[Float64]) -> float:
    """Return the mean variance of a run over all kinds and setups; `residuals` have shape (kinds, repeats)."""
    variances = [np.square(rows).sum(axis=1) / (rows.shape[1] - 1) for rows in residuals]
    return float(np.concatenate(variances).mean())


def passes_depend(runs: Mapping[Key, RunLogarithms]) -> bool:
    """Return whether neighbouring passes are more alike than distant ones, over all kinds and setups together.

    J. von Neumann's ratio (Annals of Mathematical Statistics 12, 1941) of the squared steps to the squared residuals is 2 on average for
    independent normal repeats, with the variance `4 (n - 2) / ((n - 1) (n + 1))` for n of them. Series that move
    together count as fewer.
    """
    pools = [
        (len(keys), rows[rows.any(axis=1)])
        for keys, rows in residuals_by_setup(runs).values()
        if rows.shape[1] >= MIN_RUNS and rows.any()
    ]
    if not pools:
        return False
    deficit = variance = 0.0
    for _, rows in pools:
        repeats = rows.shape[1]
        weights = np.square(rows).sum(axis=1)
        deficit += float((2 * weights - np.square(np.diff(rows, axis=1)).sum(axis=1)).sum())
        variance += 4 * (repeats - 2) / ((repeats - 1) * (repeats + 1)) * float(np.square(weights).sum())
    deviation = math.sqrt(variance * _series_as_one([rows for _, rows in pools]))
    level = DEPENDENT_UP_TO if max(kinds for kinds, _ in pools) > 1 else DEPENDENT_UP_TO_OF_ONE
    return student_cdf(-deficit / deviation, math.inf) <= level


def _series_as_one(pools: Sequence[Float64]) -> float:
    """Return the variance of a sum of squares of series that move together over the one of independent series."""
    units = [rows / np.sqrt(np.square(rows).sum(axis=1, keepdims=True)) for rows in pools]
    groups = [units]
    if len({rows.shape[1] for rows in pools}) == 1:
        groups.append([np.concatenate(units)])
    most = 1.0
    for group in groups:
        series = sum(map(len, group))
        others = sum(len(rows) ** 2 for rows in group) / series - 1
        alike = sum(float(np.square(rows.sum(axis=0)).sum()) for rows in group) / series - 1
        most = max(most, 1 + max(0.0, alike) ** 2 / others if others else 1.0)
    return most


def pooled_variance(residuals: Float64) -> tuple[float, float]:
    """Return the variance of a run and its effective degrees of freedom; `residuals` has shape (kinds, repeats)."""
    kinds, repeats = residuals.shape
    gram = residuals.T @ residuals / (repeats - 1)
    trace, square_sum = float(np.trace(gram)), float(np.square(gram).sum())
    degrees = (repeats - 1) * (trace**2 / square_sum if square_sum else 1.0)
    return trace / kinds, degrees


def spreads_are_alike(residuals: Iterable[Float64]) -> bool:
    statistic, freedom = 0.0, 0
    for residual in residuals:
        kinds, repeats = residual.shape
        if kinds < 2:
            continue
        variances = np.square(residual).sum(axis=1) / (repeats - 1)
        if not variances.all():  # runs that are equal to the digit are not of the others' spread
            return not variances.any()
        correction = 1 + (kinds + 1) / (3 * kinds * (repeats - 1))
        unlike = kinds * np.log(variances.mean()) - np.log(variances).sum()
        statistic += (repeats - 1) * float(unlike) / correction
        freedom += kinds - 1
    return not freedom or bool(special().chdtrc(freedom, statistic) >= ALIKE_FROM)


def spreads_more(residuals: Float64, index: int) -> bool:
    if len(residuals) < 2:
        return False
    (variance, degrees), (others, others_degrees) = (
        pooled_variance(part) for part in (residuals[index : index + 1], np.delete(residuals, index, axis=0))
    )
    share = others * others_degrees / (others * others_degrees + variance * degrees) if variance else 1.0
    return bool(special().betainc(others_degrees / 2, degrees / 2, share) <= MORE_UP_TO)


def tier_letters(names: Sequence[str], different: Collection[tuple[str, str]]) -> dict[str, str]:
    """Return the letters of each name: two names share one exactly if they do not differ.

    Insert and absorb (H.-P. Piepho, Journal of Computational and Graphical Statistics 13, 2004). `a` has the first name.
    """
    tiers = [frozenset(names)]
    for first, other in combinations(names, 2):
        if (first, other) not in different and (other, first) not in different:
            continue
        split = [
            part for tier in tiers for part in ((tier - {first}, tier - {other}) if {first, other} <= tier else (tier,))
        ]
        unique = list(dict.fromkeys(split))
        tiers = [tier for tier in unique if not any(tier < larger for larger in unique)]
    index = {name: number for number, name in enumerate(names)}
    tiers.sort(key=lambda tier: sorted(index[name] for name in tier))
    letters = [*ascii_letters, *(chr(0x100 + number) for number in range(len(ascii_letters), len(tiers)))]
    return {name: "".join(letters[number] for number, tier in enumerate(tiers) if name in tier) for name in names}


def overlap_in_time(first: Sequence[int], other: Sequence[int]) -> bool:
    """Return whether runs of two setups were mixed in time, by their starts: else a drift looks like a difference.

    Mixed: a run of one started before a run of the other in 10 to 90 % of all pairs of runs; at once is half before.
    """
    if not (len(first) and len(other)):
        return True
    later = np.subtract.outer(np.array(other), np.array(first))
    before = float((1 + np.sign(later)).mean()) / 2
    return LEAST_MIXED <= before <= 1 - LEAST_MIXED


LEAST_MIXED = 0.1
"""Share of pairs of runs in the rarer order; alternating setups have 0.24 or more."""
