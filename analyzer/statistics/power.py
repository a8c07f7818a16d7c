"""What an experiment could have found, and how much more it takes to decide."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .distributions import shift_for_power, student_quantile
from .intervals import EPISODES_TO_TELL, RUNS_TO_TELL
from .percentiles import planned_messages

if TYPE_CHECKING:
    from collections.abc import Callable

    from .intervals import Interval

POWER = 0.8
MOST_RUNS = 1000
"""Runs a side beyond which nobody goes on: an answer that takes more is none."""


def smallest_shift(error: float, degrees: float, confidence: float = 0.95, power: float = POWER) -> float:
    """Return the smallest true difference that a t test would have found with a probability of `power`.

    Args:
        error: standard error of the difference; of logarithms, if the shift is to be one of logarithms.
        degrees: degrees of freedom, at least 1.
        confidence: of the interval that has to exclude zero.
        power: between 0.5 and 1.
    """
    # Quarters of a degree: Welch's are fractions, and what is alike is computed once.
    return error * shift_for_power(max(1.0, math.floor(degrees * 4) / 4), confidence, power)


def runs_to_decide(
    distance: float, base_spread: float, new_spread: float, confidence: float = 0.95, power: float = POWER
) -> int | None:
    """Return the runs a side after which an interval very likely lies wholly on one side of a limit.

    Args:
        distance: of the estimate from the limit, in logarithms: `log(ratio / limit)`; its sign does not matter.
        base_spread: standard deviation of the logarithms of the base's runs.
        new_spread: the same of the new side's; 0 for a limit on one side alone, with `base_spread` that side's.
        confidence: of the interval.
        power: probability that so many runs are enough if the estimate is the truth.

    Returns:
        At least 3; None if it takes more than `MOST_RUNS`, because the estimate is next to the limit.
    """
    variance = base_spread**2 + new_spread**2
    # Welch's degrees of freedom for equal numbers of runs are (runs - 1) times this.
    share = variance**2 / (base_spread**4 + new_spread**4) if variance else 1.0

    def is_enough(runs: int) -> bool:
        error = math.sqrt(variance / runs)
        return abs(distance) >= smallest_shift(error, (runs - 1) * share, confidence, power)

    return None if distance == 0 else _fewest(is_enough)


def runs_to_narrow(spread: float, half_width: float, confidence: float = 0.95) -> int | None:
    """Return the runs after which the interval of a statistic is as narrow as asked for.

    Args:
        spread: standard deviation of the logarithms of the runs.
        half_width: of the interval of the logarithm: 0.05 is +-5 %.
        confidence: of the interval.

    Returns:
        At least 3; None if it takes more than `MOST_RUNS`.
    """

    def is_enough(runs: int) -> bool:
        return student_quantile((1 + confidence) / 2, runs - 1) * spread / math.sqrt(runs) <= half_width

    return _fewest(is_enough)


def _fewest(is_enough: Callable[[int], bool]) -> int | None:
    """Return the smallest number of runs that is enough, from `RUNS_TO_TELL` on; every larger one has to be, too."""
    if not is_enough(MOST_RUNS):
        return None
    too_few, enough = RUNS_TO_TELL - 1, MOST_RUNS
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        too_few, enough = (too_few, middle) if is_enough(middle) else (middle, enough)
    return enough


def messages_to_close(interval: Interval, quantile: float) -> int | None:
    """Return how many more messages it takes until the interval of a quantile has both ends, 0 if it has.

    Supposes that further messages are as dependent as those that were measured and come in episodes as often.

    Args:
        interval: of the quantile.
        quantile: between 0 and 1, both excluded.

    Returns:
        None where the sample has no episode to go by.
    """
    if interval.is_two_sided:
        return 0
    if not interval.samples or interval.episodes == 0:
        return None
    independent = planned_messages(quantile, interval.confidence)
    times = [independent / max(1, interval.independent)]
    if interval.episodes is not None:
        times.append(EPISODES_TO_TELL / interval.episodes)
    return max(1, math.ceil(round(interval.samples * (max(times) - 1), 6)))
