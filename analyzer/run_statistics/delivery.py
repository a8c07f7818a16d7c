"""The change of the received ratio between two sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..statistics.distributions import student_quantile
from ..statistics.intervals import Basis, Interval
from ..statistics.power import smallest_shift
from .change import Verdict
from .received import received_interval
from .two_samples import mover_ends

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class DeliveryChange:
    """Received ratios of both sides; what the samples do not support is None.

    Attributes:
        base: interval of the base's received ratio.
        new: the same of the new side.
        difference: new - base, with `difference_low` and `difference_high`, between -1 and 1.
        basis: between runs only if both sides have three.
        smallest_drop: the smallest loss of share that these runs would have found with a probability of 80 %, above 0;
            None within one run. The reach of the interval below the difference is taken for that of Student's t.
    """

    base: Interval
    new: Interval
    difference: float | None
    difference_low: float | None
    difference_high: float | None
    basis: Basis
    smallest_drop: float | None = None

    def verdict(self, same_within: float = 0.0) -> Verdict:
        """Return better, worse, the same, or that these runs cannot tell; always the latter within one run.

        Args:
            same_within: a difference wholly within `+- same_within` is the same.
        """
        low, high = self.difference_low, self.difference_high
        if self.basis is Basis.WITHIN_RUN or low is None or high is None:
            return Verdict.INCONCLUSIVE
        if -same_within <= low and high <= same_within:
            return Verdict.SAME
        if high < 0:
            return Verdict.WORSE
        return Verdict.BETTER if low > 0 else Verdict.INCONCLUSIVE


def change_of_received(
    base: Sequence[NDArray[np.bool_]], new: Sequence[NDArray[np.bool_]], confidence: float = 0.95
) -> DeliveryChange:
    """Return the change of the received ratio, its ends by R. Newcombe (Statistics in Medicine 17, 1998, method 10).

    Args:
        base: for each run of the base a bool for each message in the order of time, False for a lost one.
        new: the same of the new side.
        confidence: of every interval.
    """
    sides = [received_interval(side, confidence) for side in (base, new)]
    is_between = all(side.basis is Basis.BETWEEN_RUNS for side in sides)
    basis = Basis.BETWEEN_RUNS if is_between else Basis.WITHIN_RUN
    before, after = sides
    ends = [
        (side.value, side.lower, side.upper)
        for side in sides
        if side.value is not None and side.lower is not None and side.upper is not None
    ]
    if len(ends) < len(sides):
        return DeliveryChange(before, after, None, None, None, basis)
    low, high = mover_ends(*ends)
    difference = ends[1][0] - ends[0][0]
    smallest = None
    if is_between:
        degrees = min(side.runs for side in sides) - 1
        error = (difference - low) / student_quantile((1 + confidence) / 2, degrees)
        smallest = smallest_shift(error, degrees, confidence)
    return DeliveryChange(before, after, difference, low, high, basis, smallest)
