"""What changed between two sides' runs: Welch's test of their logarithms, Student's repeat by repeat."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..statistics.intervals import Basis, Interval
from ..statistics.power import smallest_shift
from .between_runs import Estimate, Scale, Units, scale_of
from .bursts import Float64
from .setups import ENOUGH_RUNS, campaign_variance, spreads_are_alike
from .two_samples import Ends, fieller_ends, mover_ends, paired_test, permutation_p_value, welch_test

Passes = tuple[Sequence[int], Sequence[int]]
"""For each run of the base and of the new side the repeat of the sweep it was measured in."""


class Verdict(Enum):
    BETTER = "better"
    WORSE = "worse"
    SAME = "same"  # the whole interval is within the tolerance
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True, slots=True)
class Change:
    """One statistic of one group on both sides. What the samples do not support is None.

    `typical` is of the base's and the new side's mean run, on the scale of the comparison: `ratio` and `difference` are of these two.
    """

    base: Interval
    new: Interval
    basis: Basis
    difference: float | None = None
    difference_low: float | None = None
    difference_high: float | None = None
    ratio: float | None = None
    ratio_low: float | None = None
    ratio_high: float | None = None
    p_value: float | None = None
    smallest_ratio: float | None = None
    degrees: float | None = None
    pairs: int = 0
    pair_spread: float | None = None
    typical: tuple[float | None, float | None] = (None, None)

    def verdict(self, same_within: float) -> Verdict:
        """Return the verdict on a time: the same if the ratio is wholly within `1 +- same_within`."""
        if self.basis is Basis.WITHIN_RUN or self.ratio_low is None or self.ratio_high is None:
            return Verdict.INCONCLUSIVE
        if 1 - same_within <= self.ratio_low and self.ratio_high <= 1 + same_within:
            return Verdict.SAME
        if self.ratio_high < 1:
            return Verdict.BETTER
        return Verdict.WORSE if self.ratio_low > 1 else Verdict.INCONCLUSIVE


MANY_SPREADS = 12
"""Of so many spreads a few are small by chance."""


@dataclass(frozen=True, slots=True)
class LeastVariances:
    run: float = 0.0
    pair: float = 0.0


def least_variances(sides: Iterable[tuple[Estimate, Estimate, Passes | None]]) -> LeastVariances:
    """Return the mean variances of a statistic over the groups of a comparison; 0 for a few that are alike by Bartlett's test.

    Few runs of two modes agree by chance in some of many groups, and a test would take their difference for certain.
    """
    runs: dict[tuple[int, int], list[Float64]] = {}
    pairs: dict[int, list[Float64]] = {}
    for base, new, passes in sides:
        if base.units is None or new.units is None:
            continue
        if scale_of(np.concatenate([base.units.values, new.units.values])) is not Scale.LOGARITHM:
            continue
        for side, units in enumerate((base.units, new.units)):
            logs = np.log(units.values)
            runs.setdefault((side, len(logs)), []).append(logs - logs.mean())
        paired = _pairs(base.units, new.units, passes)
        if paired is not None:
            apart = paired[1] - paired[0]
            pairs.setdefault(len(apart), []).append(apart - apart.mean())
    return LeastVariances(_least(runs.values()), _least(pairs.values()))


def _least(residuals: Iterable[list[Float64]]) -> float:
    stacked = [np.array(rows) for rows in residuals]
    is_few = sum(map(len, stacked)) < MANY_SPREADS
    return 0.0 if not stacked or (is_few and spreads_are_alike(stacked)) else campaign_variance(stacked)


def change_of_estimates(
    base: Estimate,
    new: Estimate,
    passes: Passes | None = None,
    p_of_losses: float = 1.0,
    least: LeastVariances = LeastVariances(),
) -> Change:
    """Return the change between two estimates of one statistic; `passes` are the repeats of both sides' runs.

    If a run's statistic is infinite, the reciprocals are compared. If one is not above zero, there is a difference and no ratio.
    """
    if base.units is None or new.units is None:
        return _change_within(base.interval, new.interval)
    sides = base.interval, new.interval
    scale = scale_of(np.concatenate([base.units.values, new.units.values]))
    if scale is Scale.NONE:
        return Change(*sides, Basis.BETWEEN_RUNS, typical=(base.interval.value, new.interval.value))
    if scale is Scale.RECIPROCAL:
        return _change_of_reciprocals(*sides, base.units, new.units, p_of_losses)
    if scale is Scale.LINEAR:
        return _change_of_values(*sides, base.units, new.units)
    return _change_of_logarithms(*sides, base.units, new.units, passes, least)


def _change_of_logarithms(
    base: Interval, new: Interval, base_units: Units, new_units: Units, passes: Passes | None, least: LeastVariances
) -> Change:
    logs = np.log(base_units.values), np.log(new_units.values)
    paired = _pairs(base_units, new_units, passes)
    is_few = min(map(len, logs)) < ENOUGH_RUNS
    test = (
        welch_test(*logs, least.run if is_few else 0.0)
        if paired is None
        else paired_test(*paired, least.pair if is_few else 0.0)
    )
    reach = test.reach(base.confidence)
    before, after = (
        _exponential_ends(float(values.mean()), reach * error)
        for values, error in zip(logs, (test.base_error, test.new_error), strict=True)
    )
    ratio, ratio_low, ratio_high = _exponential_ends(test.difference, reach * test.error)
    difference_low, difference_high = mover_ends(before, after)
    return Change(
        base=base,
        new=new,
        basis=Basis.BETWEEN_RUNS,
        difference=after[0] - before[0],
        difference_low=difference_low,
        difference_high=difference_high,
        ratio=ratio,
        ratio_low=ratio_low,
        ratio_high=ratio_high,
        p_value=test.p_value,
        degrees=test.degrees,
        smallest_ratio=math.exp(smallest_shift(test.error, test.degrees, base.confidence)),
        pairs=test.pairs,
        pair_spread=test.error * math.sqrt(test.pairs) if test.pairs else None,
        typical=(before[0], after[0]),
    )


def _pairs(base: Units, new: Units, passes: Passes | None) -> tuple[Float64, Float64] | None:
    if passes is None or any(len(side) != side.runs for side in (base, new)):
        return None
    common, base_index, new_index = np.intersect1d(*passes, return_indices=True)
    if not len(common) == len(base) == len(new):
        return None
    return np.log(base.values)[base_index], np.log(new.values)[new_index]


def _exponential_ends(logarithm: float, reach: float) -> Ends:
    return math.exp(logarithm), math.exp(logarithm - reach), math.exp(logarithm + reach)


def _change_of_values(base: Interval, new: Interval, base_units: Units, new_units: Units) -> Change:
    test = welch_test(base_units.values, new_units.values)
    reach = test.reach(base.confidence) * test.error
    return Change(
        base=base,
        new=new,
        basis=Basis.BETWEEN_RUNS,
        difference=test.difference,
        difference_low=test.difference - reach,
        difference_high=test.difference + reach,
        p_value=test.p_value,
        degrees=test.degrees,
        typical=(float(base_units.values.mean()), float(new_units.values.mean())),
    )


def _change_of_reciprocals(
    base: Interval, new: Interval, base_units: Units, new_units: Units, p_of_losses: float
) -> Change:
    above, below = 1 / base_units.values, 1 / new_units.values
    if not above.any() and not below.any():  # everything is lost on both sides
        return Change(base, new, Basis.BETWEEN_RUNS, typical=(math.inf, math.inf))
    test = welch_test(above, below)
    ratio_low, ratio_high = fieller_ends(above, below, test, base.confidence)
    # Where all runs of one side are lost their reciprocals do not vary, and Student's t takes five runs for certainty;
    # `p_of_losses` is the p value of the losses themselves.
    p_value = max(test.p_value, min(permutation_p_value(above, below), p_of_losses))
    return Change(
        base=base,
        new=new,
        basis=Basis.BETWEEN_RUNS,
        difference=_difference(base.value, new.value),
        difference_low=_difference(base.upper, new.lower),
        difference_high=_difference(base.lower, new.upper),
        ratio=float(above.mean() / below.mean()) if below.any() else math.inf,
        ratio_low=ratio_low,
        ratio_high=ratio_high,
        p_value=p_value,
        degrees=test.degrees,
        typical=tuple(1 / mean if (mean := float(side.mean())) else math.inf for side in (above, below)),  # type: ignore[arg-type]
    )


def _difference(base: float | None, new: float | None) -> float | None:
    if base is None or new is None or (math.isinf(base) and math.isinf(new)):
        return None
    return new - base


def _change_within(base: Interval, new: Interval) -> Change:
    before, after = _finite_ends(base), _finite_ends(new)
    difference: tuple[float | None, float | None] = (None, None)
    ratio: tuple[float | None, float | None] = (None, None)
    if before is not None and after is not None:
        difference = mover_ends(before, after)
        if min(*before, *after) > 0:
            low, high = mover_ends(_logarithms(before), _logarithms(after))
            ratio = math.exp(low), math.exp(high)
    return Change(
        base=base,
        new=new,
        basis=Basis.WITHIN_RUN,
        difference=_difference(base.value, new.value),
        difference_low=difference[0],
        difference_high=difference[1],
        ratio=_ratio(base.value, new.value),
        ratio_low=ratio[0],
        ratio_high=ratio[1],
        typical=(base.value, new.value),
    )


def _ratio(base: float | None, new: float | None) -> float | None:
    if base is None or new is None or base <= 0 or new <= 0 or math.isinf(base):
        return None
    return new / base


def _finite_ends(side: Interval) -> Ends | None:
    if side.value is None or side.lower is None or side.upper is None or math.isinf(side.upper):
        return None
    return side.value, side.lower, side.upper


def _logarithms(ends: Ends) -> Ends:
    return math.log(ends[0]), math.log(ends[1]), math.log(ends[2])
