"""A run, the runs of a group in shared arrays, and a statistic of a run. A lost message counts as infinitely late."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..statistics.percentiles import minimum_messages
from .bursts import Cells, Float64, Indices, Int64, cells_of, mean_distance, positions_of

Values = NDArray[Any]  # int64 or float64


class Run:
    """The values of one run in the order of time, infinity for a lost message; int64 `sent_ns`, None where evenly spaced."""

    def __init__(self, values: Values, sent_ns: Int64 | None = None, parts: Sequence[Run] = ()) -> None:
        self.values = values
        self.sent_ns = sent_ns
        self.parts = parts

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def ordered(self) -> Values:
        return merged([part.ordered for part in self.parts]) if self.parts else np.sort(self.values)


def merged(ascending: Sequence[Values]) -> Values:
    return np.sort(np.concatenate(ascending), kind="stable")  # timsort merges what is in order


class SendTimes:
    """When the messages of several runs were sent, run after run; `offsets` as in `Runs`. Metrics of the same messages share one."""

    def __init__(self, sent_ns: Int64, offsets: Indices) -> None:
        self.sent_ns = sent_ns
        self.offsets = offsets
        self._joined: dict[tuple[int, ...], SendTimes] = {}

    def joined(self, ends: tuple[int, ...], *, is_timed: bool) -> SendTimes:
        """Return the times of neighbours together, up to the runs at `ends`; evenly spaced unless all are timed."""
        if ends not in self._joined:
            offsets = self.offsets[[0, *ends]]
            spans = pairwise(offsets.tolist())
            parts = [
                np.cumsum(self._steps_ns[start:end]) if is_timed else np.arange(end - start) for start, end in spans
            ]
            self._joined[ends] = SendTimes(np.concatenate(parts), offsets)
        return self._joined[ends]

    @cached_property
    def by_run(self) -> list[Int64]:
        return [self.sent_ns[start:end] for start, end in pairwise(self.offsets.tolist())]

    @cached_property
    def _steps_ns(self) -> Int64:
        return np.concatenate([_steps_ns(times) for times in self.by_run])

    @cached_property
    def first_ns(self) -> Int64:
        return np.array([times[0] if len(times) else 0 for times in self.by_run], np.int64)

    @cached_property
    def distances_ns(self) -> Float64:
        return np.array([mean_distance(times) if len(times) else 1.0 for times in self.by_run])

    def positions(self, indices: Indices, events: Indices) -> Float64:
        since_first = self.sent_ns[indices] - self.first_ns.repeat(events)
        positions: Float64 = since_first / self.distances_ns.repeat(events)
        return positions


@dataclass(frozen=True, slots=True)
class Levels:
    values: tuple[float, ...]
    is_ratio: bool

    def relative(self, values: Values, level: float | Values) -> Values:
        return values / level if self.is_ratio else values - level


@dataclass(frozen=True, eq=False)
class Runs:
    """The runs of one group; shared arrays have the messages run after run, each in the order of time.

    Sorting is most of the cost of a statistic, so each run is sorted once, and what is of several runs is merged.
    """

    runs: tuple[Run, ...]

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Run]:
        return iter(self.runs)

    @classmethod
    def of(cls, runs: Runs | Sequence[Run]) -> Runs:
        return runs if isinstance(runs, Runs) else cls(tuple(runs))

    @classmethod
    def split(cls, values: Values, times: SendTimes) -> Runs:
        offsets = pairwise(times.offsets.tolist())
        runs = cls(tuple(Run(values[s:e], sent) for (s, e), sent in zip(offsets, times.by_run, strict=True)))
        runs.__dict__.update(values=values, times=times)
        return runs

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        return tuple(map(len, self.runs))

    @cached_property
    def offsets(self) -> Indices:
        return np.cumsum([0, *self.lengths])

    @cached_property
    def values(self) -> Values:
        if len(self) == 1:
            return self.runs[0].values
        return np.concatenate([run.values for run in self.runs]) if self.runs else np.empty(0)

    @cached_property
    def times(self) -> SendTimes:
        times = [np.arange(len(run)) if run.sent_ns is None else run.sent_ns for run in self.runs]
        return SendTimes(np.concatenate(times), self.offsets)

    @cached_property
    def ordered(self) -> Values:
        return self.runs[0].ordered if len(self) == 1 else merged([self.ordered_by_run])

    @cached_property
    def ordered_by_run(self) -> Values:
        if len(self) == 1:
            return self.runs[0].ordered
        ordered: Values = np.concatenate([run.ordered for run in self.runs])
        for run, (start, end) in zip(self.runs, pairwise(self.offsets.tolist()), strict=True):
            run.ordered = ordered[start:end]  # so that its own copy is freed
        return ordered

    @cached_property
    def levels(self) -> Levels:
        """The median of each run (of an infinite one the middle of the others); a single run keeps its values."""
        (medians,) = quantiles_of_runs(self, [0.5])
        is_finite = np.isfinite(medians)
        if len(self) == 1 or not is_finite.any():
            return Levels((0.0,) * len(self), is_ratio=False)
        if not is_finite.all():
            medians = np.where(is_finite, medians, np.median(medians[is_finite]))
        return Levels(tuple(medians.tolist()), is_ratio=bool((medians > 0).all()))

    @cached_property
    def relative(self) -> Values:
        return self._relative(self.values)

    @cached_property
    def ordered_relative(self) -> Values:
        return self.runs[0].ordered if len(self) == 1 else merged([self._relative(self.ordered_by_run)])

    def _relative(self, values: Values) -> Values:
        return values if len(self) == 1 else self.levels.relative(values, np.repeat(self.levels.values, self.lengths))

    @cached_property
    def cells(self) -> Cells:
        return cells_of(self.lengths)

    @property
    def joined(self) -> Runs:
        # Not cached: a single run would reference itself, and its arrays would live until the next garbage collection.
        return self if len(self) == 1 else self._joined

    @cached_property
    def _joined(self) -> Runs:
        if not self.runs:
            return Runs((Run(np.empty(0)),))
        joined = self.joined_at((len(self),))
        joined.runs[0].ordered = self.ordered
        return joined

    def joined_at(self, ends: tuple[int, ...]) -> Runs:
        is_timed = all(run.sent_ns is not None for run in self.runs)
        times = self.times.joined(ends, is_timed=is_timed)
        spans = zip(pairwise((0, *ends)), pairwise(times.offsets.tolist()), times.by_run, strict=True)
        joined = Runs(
            tuple(
                self.runs[first]
                if after == first + 1
                else Run(self.values[start:end], sent_ns if is_timed else None, self.runs[first:after])
                for (first, after), (start, end), sent_ns in spans
            )
        )
        joined.__dict__.update({"values": self.values, **({"times": times} if is_timed else {})})
        return joined

    def positions(self, indices: Indices, offsets: Indices) -> Float64:
        if len(self) == 1:
            return positions_of(indices, self.runs[0].sent_ns)
        return self.times.positions(indices, offsets[1:] - offsets[:-1])


def joined_runs(runs: Sequence[Run]) -> Run:
    return Runs.of(runs).joined.runs[0]


def _steps_ns(times: Int64) -> Int64:
    if not len(times):
        return times
    step = int(times[-1] - times[0]) // max(1, len(times) - 1)
    return np.diff(times, prepend=times[:1] - step)


@dataclass(frozen=True, slots=True)
class Statistic:
    """A quantile between 0 and 1, both excluded, or the mean (None)."""

    quantile: float | None

    @property
    def needs(self) -> int:
        return 1 if self.quantile is None else minimum_messages(self.quantile)

    def of_runs(self, runs: Runs) -> Float64:
        if self.quantile is None:
            return np.array([run.values.mean() for run in runs], np.float64)
        return quantiles_of_runs(runs, [self.quantile])[0]

    def of_run(self, run: Run) -> float:
        return float(self.of_runs(Runs((run,)))[0])


MEAN = Statistic(None)


def quantiles_of_runs(runs: Runs, quantiles: Sequence[float]) -> list[Float64]:
    """Return each quantile of each run, float64 of shape (runs,), by the median-unbiased definition.

    That is definition 8 of R. Hyndman and Y. Fan, American Statistician 50, 1996. With the summary's definition 7, of intervals of p99
    from ten runs of 150 messages 74 % contain the truth, with definition 8 94 %.
    """
    positions = np.multiply.outer(quantiles, np.add(runs.lengths, 1 / 3)) + 1 / 3
    return list(quantiles_at(runs.ordered_by_run, runs.offsets, positions))


def quantile_at(ordered: Values, position: float) -> float:
    return float(quantiles_at(ordered, np.array([0, len(ordered)]), np.array([position]))[0])


def quantiles_at(ordered: Values, offsets: Indices, positions: Float64) -> Float64:
    """Return the values of several series at 1-based positions between order statistics; infinite if one of the two is.

    Values ascend in each series, which is not empty; `offsets` are the first value of each and the number of all. A
    position, shape (..., series), outside the series is moved to its nearest value.
    """
    first, count = offsets[:-1], offsets[1:] - offsets[:-1]
    positions = np.minimum(np.maximum(positions, 1.0), count)
    below = positions.astype(np.intp)
    share = positions - below
    low = ordered[first + below - 1].astype(np.float64)
    high = ordered[first + np.minimum(below, count - 1)].astype(np.float64)
    is_between = (share > 0) & (low != high)  # an infinity must not be subtracted from itself
    np.subtract(high, low, where=is_between, out=high)
    np.multiply(high, share, where=is_between, out=high)
    np.add(low, high, where=is_between, out=low)
    return np.asarray(low, np.float64)
