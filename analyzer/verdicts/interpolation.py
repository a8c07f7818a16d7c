"""A guess for a cell that was not measured, from cells around it, with its error from cells that were held out.

Between measured sizes and rates the logarithm of the time is taken as linear in the logarithms of size and rate. That
is wrong where a limit is crossed (a socket buffer, a shared-memory segment), which is why every measured cell that has
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

Cell = tuple[float, float]
"""Payload in bytes and rate in Hz, both above 0."""

NEEDED_HELD_OUT = 3
"""Held-out cells below which no guess is made: the largest of so few errors bounds nothing."""


@dataclass(frozen=True, slots=True)
class Guess:
    """A time in an unmeasured cell.

    Attributes:
        value_ns: the interpolated time.
        error_factor: the largest factor by which a held-out cell was off, at least 1.
        held_out: how many cells were held out. With m of them, the next error is larger than all in one of m + 1.
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


def guess_cell(measured_ns: Mapping[Cell, float], cell: Cell) -> Guess | None:
    """The time of a cell from measured ones (above 0), None where they do not surround it or too few can be held out."""
    logs = {(math.log(size), math.log(rate)): math.log(value) for (size, rate), value in measured_ns.items()}
    found = _interpolate(logs, (math.log(cell[0]), math.log(cell[1])))
    errors = [abs(error) for error in _held_out_errors(logs)]
    if found is None or len(errors) < NEEDED_HELD_OUT:
        return None
    return Guess(math.exp(found), math.exp(max(errors)), len(errors))


def _held_out_errors(logs: Mapping[Cell, float]) -> Iterable[float]:
    for cell, value in logs.items():
        found = _interpolate({other: v for other, v in logs.items() if other != cell}, cell)
        if found is not None:
            yield found - value


def _interpolate(logs: Mapping[Cell, float], cell: Cell) -> float | None:
    """Along the sizes and then the rates, and the other way round; the mean of the ways that the cells allow."""
    size, rate = cell
    swapped = {(r, s): value for (s, r), value in logs.items()}
    ways = [_two_steps(logs, size, rate), _two_steps(swapped, rate, size)]
    found = [way for way in ways if way is not None]
    return sum(found) / len(found) if found else None


def _two_steps(logs: Mapping[Cell, float], first: float, second: float) -> float | None:
    lines: dict[float, dict[float, float]] = {}
    for (x, y), value in logs.items():
        lines.setdefault(y, {})[x] = value
    across = {y: found for y, line in lines.items() if (found := _between(line, first)) is not None}
    return _between(across, second)


def _between(line: Mapping[float, float], x: float) -> float | None:
    """Linear between the two nearest known points, None outside of them."""
    if x in line:
        return line[x]
    for low, high in pairwise(sorted(line)):
        if low < x < high:
            return line[low] + (line[high] - line[low]) * (x - low) / (high - low)
    return None
