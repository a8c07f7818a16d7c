"""The change of one statistic from one series to another: difference, ratio, intervals, effect."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..statistics.bootstrap import REPLICATES, SEED, bootstrap_mean, bootstrap_quantile
from ..statistics.dependence import dependence_of
from ..statistics.percentiles import PERCENTILES, planned_messages, quantile_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..statistics.percentiles import Values

    Float64 = NDArray[np.float64]

FEWEST_FOR_MEAN = 10
"""Independent messages below which a mean has no interval: the bootstrap of so few is far too narrow."""


class ChangeVerdict(Enum):
    """The verdict on a time by the interval of its ratio new / base; less is better."""

    BETTER = "better"
    WORSE = "worse"
    SAME = "same"  # the whole interval is within the tolerance
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True, slots=True)
class Change:
    """One statistic of one group on both sides; None where a sample is too small for a value or an end.

    Attributes:
        base: the statistic of the base, ns.
        new: the statistic of the new side, ns.
        new_low: lower end of its interval.
        new_high: upper end of its interval.
        difference: new - base, ns.
        difference_low: lower end of its interval.
        difference_high: upper end of its interval.
        ratio: new / base.
        ratio_low: lower end of its interval.
        ratio_high: upper end of its interval.
    """

    base: float | None
    new: float | None
    new_low: float | None
    new_high: float | None
    difference: float | None
    difference_low: float | None
    difference_high: float | None
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None

    def verdict(self, same_within: float) -> ChangeVerdict:
        """Judge the change by the interval of the ratio; `same_within` as in `CompareOptions`."""
        if self.ratio_low is None or self.ratio_high is None:
            return ChangeVerdict.INCONCLUSIVE
        if 1 - same_within <= self.ratio_low and self.ratio_high <= 1 + same_within:
            return ChangeVerdict.SAME
        if self.ratio_high < 1:
            return ChangeVerdict.BETTER
        if self.ratio_low > 1:
            return ChangeVerdict.WORSE
        return ChangeVerdict.INCONCLUSIVE


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A statistic of one sample and of its replicates; None where the sample is too small.

    Attributes:
        value: the statistic.
        drawn: float64, shape (replicates,): the statistic of each sample that the bootstrap drew.
    """

    value: float | None
    drawn: Float64 | None


class Sample:
    """A series with the statistics that were drawn from it: a series that is compared several times is drawn from once.

    Args:
        values: the series in the order of time.
    """

    def __init__(self, values: Values) -> None:
        self.values = values
        self._drawn: dict[tuple[str, float, int, int], Drawn] = {}

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def ordered(self) -> Values:
        """The values in rising order."""
        return np.sort(self.values)

    def draw(self, statistic: str, confidence: float, replicates: int, seed: int) -> Drawn:
        """Return a statistic (`mean` or the name of a percentile) of the series and of `replicates` samples drawn from it."""
        how = (statistic, confidence, replicates, seed)
        if how not in self._drawn:
            make = self._mean if statistic == "mean" else self._percentile
            self._drawn[how] = make(*how)
        return self._drawn[how]

    def _mean(self, _: str, __: float, replicates: int, seed: int) -> Drawn:
        if not len(self):
            return Drawn(None, None)
        dependence = dependence_of(self.values)
        mean = float(self.values.mean())
        if len(self) / dependence.inflation < FEWEST_FOR_MEAN:
            return Drawn(mean, None)
        block = dependence.block_messages
        return Drawn(mean, bootstrap_mean(self.values, block, replicates=replicates, seed=seed))

    def _percentile(self, name: str, confidence: float, replicates: int, seed: int) -> Drawn:
        percentile = next(p for p in PERCENTILES if p.name == name)
        if len(self) < percentile.needs:
            return Drawn(None, None)
        value = quantile_of(self.ordered, percentile.quantile)
        dependence = dependence_of(self.values <= value)
        if len(self) < planned_messages(percentile.quantile, confidence, dependence.inflation):
            return Drawn(value, None)
        drawn = bootstrap_quantile(
            self.values,
            percentile.quantile,
            dependence.block_messages,
            replicates=replicates,
            seed=seed,
            ordered=self.ordered,
        )
        return Drawn(value, drawn)


def change_of(
    base: Sample,
    new: Sample,
    statistic: str,
    confidence: float = 0.95,
    replicates: int = REPLICATES,
) -> Change:
    """Compare a statistic of two series.

    Args:
        base: values of the base.
        new: values of the new side.
        statistic: `mean` or the name of a percentile.
        confidence: of the intervals; an end is known only if both samples are worth enough messages for it.
        replicates: draws of the bootstrap.
    """
    before, after = (
        side.draw(statistic, confidence, replicates, SEED + number) for number, side in enumerate((base, new))
    )
    tail = [(1 - confidence) / 2, (1 + confidence) / 2]
    low = high = ratio_low = ratio_high = None
    if before.drawn is not None and after.drawn is not None:
        low, high = np.quantile(after.drawn - before.drawn, tail).tolist()
        if before.drawn.min() > 0:
            ratio_low, ratio_high = np.quantile(after.drawn / before.drawn, tail).tolist()
    new_low, new_high = (None, None) if after.drawn is None else np.quantile(after.drawn, tail).tolist()
    difference = ratio = None
    if before.value is not None and after.value is not None:
        difference = after.value - before.value
        ratio = after.value / before.value if before.value > 0 else None
    return Change(
        base=before.value,
        new=after.value,
        new_low=new_low,
        new_high=new_high,
        difference=difference,
        difference_low=low,
        difference_high=high,
        ratio=ratio,
        ratio_low=ratio_low,
        ratio_high=ratio_high,
    )


def probability_of_superiority(base: Sample, new: Sample) -> float | None:
    """Return how often a value drawn from `new` is below one drawn from `base`, ties counted half; None without values.

    One half means no difference, 1 that every new message is faster than every one of the base.
    """
    if not len(base) or not len(new):
        return None
    # Looked up in rising order: neighbours of one search are still in the cache at the next.
    not_above = np.searchsorted(base.ordered, new.ordered, side="right")
    ties = not_above - np.searchsorted(base.ordered, new.ordered, side="left")
    above = len(base) - not_above
    return float((above + ties / 2).mean() / len(base))
