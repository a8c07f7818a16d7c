"""A guess for a size and rate that were not measured, with its error from measurements that were held out.

Between measured sizes and rates the logarithm of the time is taken as linear in the logarithms of size and rate. That
is wrong where a limit is crossed (a socket buffer, a shared-memory segment), which is why every measurement that has
neighbours is predicted from them as if it were unknown: the largest of these errors is the guess's own. Nothing is
guessed outside of what was measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

SizeAndRate = tuple[float, float]
"""Payload in bytes and rate in Hz, both above 0."""

FEWEST_HELD_OUT = 3
"""Held-out measurements below which no guess is made: the largest of so few errors bounds nothing."""


@dataclass(frozen=True, slots=True)
class Guess:
    """A time that was not measured.

    Attributes:
        value_ns: the interpolated time.
        error_factor: the largest factor by which a held-out measurement was off, at least 1.
        held_out: number of held-out measurements. With m of them, the next error exceeds all of theirs in one case
            of m + 1.
    """

    value_ns: float
    error_factor: float
    held_out: int

    @property
    def lower_ns(self) -> float:
        """The value divided by its error factor."""
        return self.value_ns / self.error_factor

    @property
    def upper_ns(self) -> float:
        """The value times its error factor."""
        return self.value_ns * self.error_factor


def guess_time(measured_ns: Mapping[SizeAndRate, float], at: SizeAndRate) -> Guess | None:
    """Guess a time from measured ones; None if these do not surround it, or too few of them can be held out.

    Args:
        measured_ns: times above 0.
        at: size and rate of the guess.
    """
    logs = {(math.log(size), math.log(rate)): math.log(value) for (size, rate), value in measured_ns.items()}
    log_value = _interpolate(logs, (math.log(at[0]), math.log(at[1])))
    errors = [abs(error) for error in _held_out_errors(logs)]
    if log_value is None or len(errors) < FEWEST_HELD_OUT:
        return None
    return Guess(math.exp(log_value), math.exp(max(errors)), len(errors))


def _held_out_errors(logs: Mapping[SizeAndRate, float]) -> Iterable[float]:
    for at, value in logs.items():
        predicted = _interpolate({other: v for other, v in logs.items() if other != at}, at)
        if predicted is not None:
            yield predicted - value


def _interpolate(logs: Mapping[SizeAndRate, float], at: SizeAndRate) -> float | None:
    """Interpolate along the sizes and then the rates, and the other way round; return the mean of what is possible."""
    size, rate = at
    swapped = {(r, s): value for (s, r), value in logs.items()}
    ways = [_two_steps(logs, size, rate), _two_steps(swapped, rate, size)]
    values = [value for value in ways if value is not None]
    return sum(values) / len(values) if values else None


def _two_steps(logs: Mapping[SizeAndRate, float], first: float, second: float) -> float | None:
    """Interpolate along the first coordinate on every line of equal second one, then between these lines."""
    lines: dict[float, dict[float, float]] = {}
    for (x, y), value in logs.items():
        lines.setdefault(y, {})[x] = value
    across = {y: at_first for y, line in lines.items() if (at_first := _between(line, first)) is not None}
    return _between(across, second)


def _between(line: Mapping[float, float], x: float) -> float | None:
    """Interpolate linearly between the two nearest known points; None outside of them."""
    if x in line:
        return line[x]
    for low, high in pairwise(sorted(line)):
        if low < x < high:
            return line[low] + (line[high] - line[low]) * (x - low) / (high - low)
    return None
