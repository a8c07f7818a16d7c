"""One run of a group, and a statistic of it: a quantile or the mean.

A lost message is an infinitely late one: it stands in a run as infinity, and so a quantile beyond which more messages
were lost than the quantile leaves room for is infinite too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..statistics.percentiles import minimum_messages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Values = NDArray[Any]  # int64 or float64
    Int64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Levels:
    """The levels that the runs of a group are compared at.

    Attributes:
        of_runs: the level of each run.
        is_ratio: whether values are divided by it, or it is taken off.
    """

    of_runs: tuple[float, ...]
    is_ratio: bool

    def relative(self, values: Values, level: float) -> Values:
        """Return values at a level of 1, or of 0; in the same order."""
        return values / level if self.is_ratio else values - level


class Run:
    """The values of one run in the order of time; what was computed of them is kept.

    Args:
        values: int64 or float64, infinity for a lost message, shape (messages,).
        sent_ns: when each message was sent, int64 ns, rising; None where messages are equally far apart.
    """

    def __init__(self, values: Values, sent_ns: Int64 | None = None) -> None:
        self.values = values
        self.sent_ns = sent_ns
        self._relative: tuple[tuple[bool, float], tuple[Values, Values]] | None = None

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def ordered(self) -> Values:
        """The values rising."""
        return np.sort(self.values)

    @cached_property
    def median(self) -> float:
        """The median, by the median-unbiased definition."""
        return Statistic(0.5).of_run(self)

    def relative(self, levels: Levels, level: float) -> tuple[Values, Values]:
        """Return the values relative to a level, in the order of time and rising.

        Every percentile of a group asks for the same level, which is kept; another one takes its place.
        """
        key = levels.is_ratio, level
        if self._relative is None or self._relative[0] != key:
            self._relative = key, (levels.relative(self.values, level), levels.relative(self.ordered, level))
        return self._relative[1]


def joined_runs(runs: Sequence[Run]) -> Run:
    """Return several runs as one series, in their order; a single run is returned as it is, no run as an empty one.

    Times of sending are moved so that the runs follow each other: an episode does not outlive its run by more than
    the pause between two messages.
    """
    if not runs:
        return Run(np.empty(0))
    if len(runs) == 1:
        return runs[0]
    values = np.concatenate([run.values for run in runs])
    if any(run.sent_ns is None for run in runs):
        return Run(values)
    return Run(values, np.cumsum(np.concatenate([_steps_ns(run) for run in runs])))


def _steps_ns(run: Run) -> Int64:
    """Return the time since the message before, for the first one the mean of the run."""
    times = run.sent_ns
    assert times is not None
    step = int(times[-1] - times[0]) // max(1, len(times) - 1) if len(times) else 0
    return np.diff(times, prepend=times[:1] - step)


@dataclass(frozen=True, slots=True)
class Statistic:
    """What is estimated of a run and of the distribution behind it.

    Attributes:
        quantile: between 0 and 1, both excluded; None for the mean.
    """

    quantile: float | None

    @property
    def needs(self) -> int:
        """Messages below which a run does not support the statistic."""
        return 1 if self.quantile is None else minimum_messages(self.quantile)

    def of_run(self, run: Run) -> float:
        """Return the statistic of a run; a quantile by the median-unbiased definition.

        That is definition 8 of R. Hyndman and Y. Fan, "Sample quantiles in statistical packages", American
        Statistician 50, 1996. The summary's definition 7 is below the truth where few messages lie beyond the
        quantile, and a mean over runs does not cure that: from ten runs of 150 independent messages it leaves
        74 of 100 intervals of p99 with the truth inside, definition 8 leaves 94.
        """
        if self.quantile is None:
            return float(run.values.mean())
        return quantile_at(run.ordered, (len(run) + 1 / 3) * self.quantile + 1 / 3)


MEAN = Statistic(None)


def quantile_at(ordered: Values, position: float) -> float:
    """Return the value at a 1-based position between order statistics; infinite if one of the two is.

    Args:
        ordered: the values rising, at least one.
        position: is moved to the nearest order statistic if it lies outside.
    """
    position = min(max(position, 1.0), float(len(ordered)))
    below = math.floor(position)
    share = position - below
    low = float(ordered[below - 1])
    high = float(ordered[min(below, len(ordered) - 1)])
    return low if share == 0 or low == high else low + (high - low) * share
