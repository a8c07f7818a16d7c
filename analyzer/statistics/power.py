"""What an experiment can detect, what it takes to decide, and p values of many tests."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from .distributions import shift_for_power
from .intervals import MIN_RUNS, Interval, messages_to_end
from .percentiles import planned_messages

Float64 = NDArray[np.float64]


def holm_adjusted(p_values: Sequence[float] | Float64) -> Float64:
    """Bound the probability of a single false alarm in the family; in the order of the tests.

    The i-th smallest of m becomes the largest `(m - j + 1) p_j` up to it (S. Holm, Scandinavian Journal of Statistics 6, 1979).
    """
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values, kind="stable")
    steps = np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1))
    return _in_order(np.minimum(steps, 1.0), order)


def hochberg_adjusted(p_values: Sequence[float] | Float64) -> Float64:
    """Bound the same as Holm's; in the order of the tests.

    The i-th smallest of m becomes the smallest `(m - j + 1) p_j` from it on (Y. Hochberg, Biometrika 75, 1988), for independent
    or positively dependent tests; none is larger than Holm's.
    """
    return _stepped_up(p_values, lambda ascending: ascending * np.arange(len(ascending), 0, -1))


def benjamini_hochberg_adjusted(p_values: Sequence[float] | Float64) -> Float64:
    """Bound the expected share of false alarms among alarms; in the order of the tests.

    The i-th smallest of m becomes the smallest `m p_j / j` from it on (Y. Benjamini and Y. Hochberg, JRSS B 57, 1995), for
    independent or positively dependent tests.
    """
    return _stepped_up(p_values, lambda ascending: ascending * len(ascending) / np.arange(1, len(ascending) + 1))


def _stepped_up(p_values: Sequence[float] | Float64, steps_of: Callable[[Float64], Float64]) -> Float64:
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values, kind="stable")
    falling = np.minimum.accumulate(steps_of(values[order])[::-1])[::-1]
    return _in_order(np.minimum(falling, 1.0), order)


def _in_order(sorted_values: Float64, order: NDArray[np.intp]) -> Float64:
    values = np.empty_like(sorted_values)
    values[order] = sorted_values
    return values


POCOCK_LEVELS = (0.05, 0.0294, 0.0221, 0.0182, 0.0158, 0.0142, 0.0130, 0.0120, 0.0112, 0.0106)
"""Level of each of 1 to 10 looks at equally growing data, for 5 % over all (S. J. Pocock, Biometrika 64, 1977).

It spends `0.05 log(1 + (e - 1) t)` by the share t of the data (K. Lan and D. DeMets, Biometrika 70, 1983).
"""


def confidence_at_each(looks: int) -> float:
    """Return the confidence of a look that keeps 95 % over all, up to ten."""
    return 1 - POCOCK_LEVELS[looks - 1]


POWER = 0.8
MOST_RUNS = 1000
"""Runs a side; beyond, no number is given."""


def smallest_shift(error: float, degrees: float, confidence: float = 0.95, power: float = POWER) -> float:
    return error * shift_for_power(whole_degrees(degrees), confidence, power)


def whole_degrees(degrees: float) -> float:
    """Return quarters of a degree: Welch's are fractions, and what is alike is computed once."""
    return max(1.0, math.floor(degrees * 4) / 4)


def runs_to_decide(
    distance: float, base_spread: float, new_spread: float, confidence: float = 0.95, power: float = POWER
) -> int | None:
    """Return the runs a side (3 to `MOST_RUNS`) after which an interval is on one side of a limit with a probability of `power`.

    `distance` is `log(ratio / limit)`, a spread the standard deviation of the logarithms of a side's runs; 0 for a limit there.
    """
    variance = base_spread**2 + new_spread**2
    # Welch's degrees of freedom for equal numbers of runs are (runs - 1) times this.
    share = variance**2 / (base_spread**4 + new_spread**4) if variance else 1.0

    def is_enough(runs: int) -> bool:
        error = math.sqrt(variance / runs)
        return abs(distance) >= smallest_shift(error, (runs - 1) * share, confidence, power)

    return None if distance == 0 else _fewest(is_enough)


def _fewest(is_enough: Callable[[int], bool]) -> int | None:
    counts = range(MIN_RUNS, MOST_RUNS + 1)
    place = bisect_left(counts, True, key=is_enough)
    return counts[place] if place < len(counts) else None


def messages_to_close(interval: Interval, quantile: float) -> int | None:
    """Return the further messages until a quantile's interval has both ends; None without a message."""
    if interval.is_two_sided:
        return 0
    if not interval.samples:
        return None
    least = max(planned_messages(quantile, interval.confidence), messages_to_end(quantile))
    return max(1, least - interval.samples)
