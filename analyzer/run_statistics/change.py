"""What changed from one side's runs to the other's: difference, ratio, their intervals, a verdict.

With three runs a side the runs decide: Welch's test of the logarithms of the runs' statistics, or Student's test of
their differences pass by pass where a sweep measured both sides in the same passes. With fewer runs there is an
interval within one run, and no verdict.

Pairs pay where the machine drifts and both sides of a pass share that: of 5 passes with a spread of 5 %, a difference of
10 % is found in 88 of 100 against 78 by Welch's test where the sides correlate by 0.5, in 74 with both at 0.25, and in 62
against 72 where they do not. Both are false in at most 5 of 100.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.intervals import Basis, Interval
from ..statistics.power import smallest_shift
from .between_runs import (
    Scale,
    Units,
    interval_of_runs,
    interval_of_units,
    measured_units,
    scale_of,
)
from .two_samples import (
    StudentTest,
    fieller_ends,
    mover_ends,
    paired_test,
    welch_test,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .runs import Run, Statistic
    from .two_samples import Ends

    Passes = tuple[Sequence[int], Sequence[int]]
    from .runs import Values


def probability_of_superiority(base: Values, new: Values) -> float | None:
    """Return how often a value drawn from `new` is below one drawn from `base`, ties counted half; None without values.

    One half means no difference, 1 that every new message is faster than every one of the base (R. McGraw and S. Wong,
    "A common language effect size statistic", Psychological Bulletin 111, 1992).

    Args:
        base: rising, infinity for a lost message.
        new: likewise.
    """
    if not len(base) or not len(new):
        return None
    # Looked up in rising order: neighbours of one search are still in the cache at the next.
    not_above = np.searchsorted(base, new, side="right")
    ties = not_above - np.searchsorted(base, new, side="left")
    above = len(base) - not_above
    return float((above + ties / 2).mean() / len(base))


class Verdict(Enum):
    """What the interval of a change says of a side."""

    BETTER = "better"
    WORSE = "worse"
    SAME = "same"  # the whole interval is within the tolerance
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True, slots=True)
class Change:
    """One statistic of one group on both sides. What the samples do not support is None.

    Attributes:
        base: interval of the statistic of the base.
        new: the same of the new side.
        basis: between runs only if both sides have three.
        difference: new - base, with `difference_low` and `difference_high`.
        ratio: new / base, with `ratio_low` and `ratio_high`; infinite where the new side lost too much; None where a
            side is not above zero.
        p_value: probability of a difference like this between equal sides; None within one run.
        smallest_ratio: the smallest ratio above 1 that these runs would have found with a probability of 80 %.
        degrees: degrees of freedom of the test; None within one run.
        pairs: passes that were compared one by one; 0 for Welch's test.
        pair_spread: standard deviation of their differences of logarithms; None for Welch's test.
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

    def verdict(self, same_within: float) -> Verdict:
        """Return better, worse, the same, or that these runs cannot tell, of a time, where less is better.

        Args:
            same_within: a ratio wholly within `1 +- same_within` is the same.

        Returns:
            Always `INCONCLUSIVE` within one run.
        """
        if self.basis is Basis.WITHIN_RUN or self.ratio_low is None or self.ratio_high is None:
            return Verdict.INCONCLUSIVE
        if 1 - same_within <= self.ratio_low and self.ratio_high <= 1 + same_within:
            return Verdict.SAME
        if self.ratio_high < 1:
            return Verdict.BETTER
        return Verdict.WORSE if self.ratio_low > 1 else Verdict.INCONCLUSIVE


def change_of_runs(
    base: Sequence[Run],
    new: Sequence[Run],
    statistic: Statistic,
    confidence: float = 0.95,
    passes: Passes | None = None,
) -> Change:
    """Return the change of a statistic between two sides.

    If a run's statistic is infinite, the reciprocals are compared, of which none is; the ratio's upper end is
    infinite where the new side's reciprocal is not surely above zero. If one is not above zero, there is a difference
    and no ratio.

    Args:
        base: runs of the base in the order of time.
        new: runs of the new side, likewise.
        statistic: what is compared.
        confidence: of every interval.
        passes: for each run of the base and of the new side the pass of the sweep it was measured in; None without
            passes.
    """
    of_base, of_new = (measured_units(side, statistic) for side in (base, new))
    if of_base is None or of_new is None:
        before, after = (interval_of_runs(side, statistic, confidence) for side in (base, new))
        return _within(before, after)
    compare = {
        Scale.LOGARITHM: _of_logarithms,
        Scale.LINEAR: _of_differences,
        Scale.RECIPROCAL: _of_reciprocals,
        Scale.NONE: _of_nothing,
    }[scale_of(np.concatenate([of_base.values, of_new.values]))]
    return compare(_Sides(of_base, of_new, statistic, confidence, passes))


@dataclass(frozen=True, slots=True, eq=False)
class _Sides:
    """Both sides with at least three units each."""

    of_base: Units
    of_new: Units
    statistic: Statistic
    confidence: float
    passes: Passes | None

    @property
    def base(self) -> Interval:
        return interval_of_units(self.of_base, self.statistic, self.confidence)

    @property
    def new(self) -> Interval:
        return interval_of_units(self.of_new, self.statistic, self.confidence)


def _of_logarithms(sides: _Sides) -> Change:
    test = _test_of_logarithms(sides)
    reach = test.reach(sides.confidence)
    base, new = (
        _exponential_ends(float(np.log(units.values).mean()), reach * error)
        for units, error in ((sides.of_base, test.base_error), (sides.of_new, test.new_error))
    )
    ratio, ratio_low, ratio_high = _exponential_ends(test.difference, reach * test.error)
    difference_low, difference_high = mover_ends(base, new)
    return Change(
        base=sides.base,
        new=sides.new,
        basis=Basis.BETWEEN_RUNS,
        difference=new[0] - base[0],
        difference_low=difference_low,
        difference_high=difference_high,
        ratio=ratio,
        ratio_low=ratio_low,
        ratio_high=ratio_high,
        p_value=test.p_value,
        degrees=test.degrees,
        smallest_ratio=math.exp(smallest_shift(test.error, test.degrees, sides.confidence)),
        pairs=test.pairs,
        pair_spread=test.error * math.sqrt(test.pairs) if test.pairs else None,
    )


def _test_of_logarithms(sides: _Sides) -> StudentTest:
    """Return the test: pass by pass if every unit is one run and every run has its partner."""
    base, new = np.log(sides.of_base.values), np.log(sides.of_new.values)
    if sides.passes is not None and all(len(side) == side.runs for side in (sides.of_base, sides.of_new)):
        common, of_base, of_new = np.intersect1d(*sides.passes, return_indices=True)
        if len(common) == len(base) == len(new):
            return paired_test(base[of_base], new[of_new])
    return welch_test(base, new)


def _exponential_ends(logarithm: float, reach: float) -> tuple[float, float, float]:
    return math.exp(logarithm), math.exp(logarithm - reach), math.exp(logarithm + reach)


def _of_differences(sides: _Sides) -> Change:
    test = welch_test(sides.of_base.values, sides.of_new.values)
    reach = test.reach(sides.confidence) * test.error
    return Change(
        base=sides.base,
        new=sides.new,
        basis=Basis.BETWEEN_RUNS,
        difference=test.difference,
        difference_low=test.difference - reach,
        difference_high=test.difference + reach,
        p_value=test.p_value,
        degrees=test.degrees,
    )


def _of_reciprocals(sides: _Sides) -> Change:
    """Compare mean reciprocals: the base's over the new side's is new / base of the statistic."""
    base, new = sides.base, sides.new
    above, below = 1 / sides.of_base.values, 1 / sides.of_new.values
    if not above.any() and not below.any():  # everything is lost on both sides
        return Change(base, new, Basis.BETWEEN_RUNS)
    test = welch_test(above, below)
    ratio_low, ratio_high = fieller_ends(above, below, test, sides.confidence)
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
        p_value=test.p_value,
        degrees=test.degrees,
    )


def _of_nothing(sides: _Sides) -> Change:
    return Change(sides.base, sides.new, Basis.BETWEEN_RUNS)


def _difference(base: float | None, new: float | None) -> float | None:
    """Return new - base; None where either is unknown or both are infinite."""
    if base is None or new is None or (math.isinf(base) and math.isinf(new)):
        return None
    return new - base


def _within(base: Interval, new: Interval) -> Change:
    """Put the sides' own intervals together: for the difference as they are, for the ratio by their logarithms."""
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
    )


def _ratio(base: float | None, new: float | None) -> float | None:
    """Return new / base; None where either is unknown or not above zero, or the base is infinite."""
    if base is None or new is None or base <= 0 or new <= 0 or math.isinf(base):
        return None
    return new / base


def _finite_ends(side: Interval) -> Ends | None:
    if side.value is None or side.lower is None or side.upper is None or math.isinf(side.upper):
        return None
    return side.value, side.lower, side.upper


def _logarithms(ends: Ends) -> Ends:
    return math.log(ends[0]), math.log(ends[1]), math.log(ends[2])
