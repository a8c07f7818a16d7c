"""One run of a group, and a statistic of it: a quantile or the mean.

A lost message is an infinitely late one: it stands in a run as infinity, and so a quantile beyond which more messages
were lost than the quantile leaves room for is infinite too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..statistics.percentiles import minimum_messages
from ..statistics.thresholds import places_beyond, thresholds_of
from .bursts import Cells, cells_of, mean_distance, positions_of, share_inflations

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Values = NDArray[Any]  # int64 or float64
    Int64 = NDArray[np.int64]

Found = TypeVar("Found")


@dataclass(frozen=True, slots=True)
class Levels:
    """The levels that the runs of a group are compared at.

    Attributes:
        of_runs: the level of each run.
        is_ratio: whether values are divided by it, or it is taken off.
    """

    of_runs: tuple[float, ...]
    is_ratio: bool

    def relative(self, values: Values, level: float | Values) -> Values:
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

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def ordered(self) -> Values:
        """The values rising."""
        return np.sort(self.values)


@dataclass(frozen=True, slots=True, eq=False)
class Beyond:
    """The messages of several runs beyond a threshold, those of the first run first.

    Attributes:
        places: intp, where they stand in the arrays of `Runs`, rising, shape (events,).
        positions: float64, when they were sent, in mean distances of their run's messages since its first, shape (events,).
        edges: intp, the first of each run and the number of all, shape (runs + 1,).
    """

    places: NDArray[np.intp]
    positions: NDArray[np.float64]
    edges: NDArray[np.intp]

    def of_runs(self, values: Values) -> list[Values]:
        """Cut an array of all of them into those of each run."""
        return [values[begin:end] for begin, end in pairwise(self.edges.tolist())]


class Times:
    """When the messages of several runs were sent, the runs side by side; all metrics of the same messages share what follows from it.

    Args:
        sent_ns: int64 ns, rising in each run, shape (messages,).
        edges: the first message of each run and the number of all, shape (runs + 1,).
    """

    def __init__(self, sent_ns: Int64, edges: NDArray[np.intp]) -> None:
        self.sent_ns = sent_ns
        self.edges = edges

    @cached_property
    def of_runs(self) -> list[Int64]:
        """Those of each run."""
        return [self.sent_ns[begin:end] for begin, end in pairwise(self.edges.tolist())]

    @cached_property
    def first_ns(self) -> Int64:
        """When the first message of each run was sent; 0 of a run without any."""
        return np.array([times[0] if len(times) else 0 for times in self.of_runs], np.int64)

    @cached_property
    def distance_ns(self) -> NDArray[np.float64]:
        """The mean distance of the messages of each run."""
        return np.array([mean_distance(times) if len(times) else 1.0 for times in self.of_runs])

    @cached_property
    def joined_ns(self) -> Int64:
        """Times of the runs as one series (`joined_runs`)."""
        return np.cumsum(np.concatenate([_steps_ns(times) for times in self.of_runs]))


class Runs(tuple[Run, ...]):  # noqa: SLOT001 - what is kept needs a `__dict__`
    """The runs of a group side by side: what the statistics of all of them rest on is computed once, for all at a time.

    Arrays have the messages of the first run in the order of time, then those of the second, and so on.

    Attributes:
        quantiles: those that will be asked for: what is found for one of them is found for all at once, and kept.
    """

    quantiles: tuple[float, ...] = ()

    @classmethod
    def cut(cls, values: Values, times: Times, quantiles: tuple[float, ...] = ()) -> Runs:
        """Return runs that stand side by side in an array already, a value of each message."""
        held = zip(pairwise(times.edges.tolist()), times.of_runs, strict=True)
        found = cls(Run(values[begin:end], sent_ns) for (begin, end), sent_ns in held)
        found.quantiles, found.values, found.times = quantiles, values, times
        return found

    @classmethod
    def of(cls, runs: Sequence[Run], quantiles: tuple[float, ...] = ()) -> Runs:
        """Return the runs side by side; as they are if they stand so already."""
        if isinstance(runs, Runs):
            return runs
        found = cls(runs)
        found.quantiles = quantiles
        return found

    @property
    def groups(self) -> Sequence[Runs]:
        """The groups that the runs are of: one, but for those of `Groups`."""
        return (self,)

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """Messages of each run."""
        return tuple(map(len, self))

    @property
    def joined(self) -> Runs:
        """The runs as one series (`joined_runs`)."""
        # Kept, one run would hold itself and so its arrays, until the collector of garbage comes by.
        return self if len(self) == 1 else self._joined

    @cached_property
    def _joined(self) -> Runs:
        joined = joined_runs(self)
        if len(self) > 1:
            joined.ordered = self.all_ordered
        return Runs.of([joined], self.quantiles)

    @cached_property
    def edges(self) -> NDArray[np.intp]:
        """The first message of each run and the number of all, shape (runs + 1,)."""
        return np.cumsum([0, *self.lengths])

    @cached_property
    def levels(self) -> Levels:
        """The median of each run; to be taken off if one is not above zero. One run alone is left as it is.

        A run whose median is infinite is given the middle level of the others.
        """
        medians = self.quantile(0.5)
        is_finite = np.isfinite(medians)
        if len(self) == 1 or not is_finite.any():
            return Levels((0.0,) * len(self), is_ratio=False)
        if not is_finite.all():
            medians = np.where(is_finite, medians, np.median(medians[is_finite]))
        return Levels(tuple(medians.tolist()), is_ratio=bool((medians > 0).all()))

    @cached_property
    def values(self) -> Values:
        """The values."""
        return np.concatenate([run.values for run in self]) if len(self) > 1 else self[0].values

    @cached_property
    def each_ordered(self) -> Values:
        """The values of each run, rising."""
        if len(self) == 1:
            return self[0].ordered
        ordered: Values = self.values.copy()
        for run, begin, end in zip(self, self.edges.tolist(), self.edges[1:].tolist(), strict=False):
            run.ordered = ordered[begin:end]
            run.ordered.sort()
        return ordered

    @cached_property
    def relative(self) -> Values:
        """The values relative to the level of their run."""
        if len(self) == 1:
            return self.values
        return self.levels.relative(self.values, np.repeat(self.levels.of_runs, self.lengths))

    @cached_property
    def ordered(self) -> Values:
        """The same, rising."""
        return np.sort(self.relative) if len(self) > 1 else self[0].ordered

    @cached_property
    def all_ordered(self) -> Values:
        """The values themselves, rising."""
        return np.sort(self.values) if len(self) > 1 else self[0].ordered

    @cached_property
    def cells(self) -> Cells:
        """The cells that neighbouring messages are added up in."""
        return cells_of(self.lengths)

    @cached_property
    def _kept(self) -> dict[tuple[object, float], Any]:
        return {}

    def of_quantile(self, quantile: float, find: Callable[[Runs, Sequence[float]], Sequence[Found]]) -> Found:
        """Return what a function finds for a quantile. It is asked for all `quantiles` at once, and what it found is kept.

        Args:
            quantile: between 0 and 1, both excluded.
            find: returns what it finds for each of some quantiles.
        """
        if (find, quantile) not in self._kept:
            together = self.quantiles if quantile in self.quantiles else (quantile,)
            for each, found in zip(together, find(self, together), strict=True):
                self.keep(each, find, found)
        kept: Found = self._kept[find, quantile]
        return kept

    def keep(self, quantile: float, find: object, found: object) -> None:
        """Keep what `find` found, for `of_quantile`."""
        self._kept[find, quantile] = found

    def quantile(self, quantile: float) -> NDArray[np.float64]:
        """Return a quantile of each run, by the median-unbiased definition (`Statistic.of_runs`), shape (runs,)."""
        return self.of_quantile(quantile, find_quantiles)

    def beyond(self, quantile: float) -> Beyond:
        """Return the messages beyond a quantile of all of them, each relative to the level of its run."""
        return self.of_quantile(quantile, _find_beyond)

    def inflations(self, quantile: float) -> list[float]:
        """Return the variance of the share that these messages have of each run, divided by that of independent ones."""
        return self.of_quantile(quantile, find_inflations)

    def at(self, places: NDArray[np.intp]) -> Beyond:
        """Return the messages at some places, which rise."""
        edges = places.searchsorted(self.edges)
        return Beyond(places, self._positions_at(places, edges), edges)

    def _positions_at(self, places: NDArray[np.intp], edges: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the positions of messages of all runs: `positions_of` each run, at once."""
        if len(self) == 1:
            return positions_of(places, self[0].sent_ns)
        times, events = self.times, edges[1:] - edges[:-1]
        since_first = times.sent_ns[places] - times.first_ns.repeat(events)
        positions: NDArray[np.float64] = since_first / times.distance_ns.repeat(events)
        return positions

    @cached_property
    def times(self) -> Times:
        """When each message was sent: numbers where no times are known."""
        of_runs = [np.arange(len(run)) if run.sent_ns is None else run.sent_ns for run in self]
        return Times(np.concatenate(of_runs), self.edges)


class Groups(Runs):
    """Several groups as if they were one: what is found for each run is found for those of all groups at once.

    Numpy takes as long to begin with an array as to work at some thousand values, so that small groups cost little more
    together than one of them does.
    """

    _groups: Sequence[Runs] = ()

    @classmethod
    def together(cls, groups: Sequence[Runs]) -> Groups:
        """Put groups of the same `quantiles` one behind the other."""
        found = cls(run for group in groups for run in group)
        found._groups, found.quantiles = groups, groups[0].quantiles
        return found

    @property
    def groups(self) -> Sequence[Runs]:
        """The groups."""
        return self._groups

    @cached_property
    def relative(self) -> Values:
        """The values relative to the level of their run in its group."""
        return np.concatenate([group.relative for group in self._groups])

    def find(self, find: Callable[[Runs, Sequence[float]], Sequence[Any]]) -> None:
        """Let a function find something for each run, and keep it in their groups.

        Args:
            find: returns for each of some quantiles a sequence with what it finds for each run.
        """
        for quantile in self.quantiles:
            of_runs, first = self.of_quantile(quantile, find), 0
            for group in self._groups:
                group.keep(quantile, find, of_runs[first : first + len(group)])
                first += len(group)


def find_quantiles(runs: Runs, quantiles: Sequence[float]) -> list[NDArray[np.float64]]:
    """Return each quantile of each run; see `Runs.quantile`."""
    positions = np.multiply.outer(quantiles, np.add(runs.lengths, 1 / 3)) + 1 / 3
    return list(quantiles_at(runs.each_ordered, runs.edges, positions))


def _find_beyond(runs: Runs, quantiles: Sequence[float]) -> list[Beyond]:
    thresholds = [thresholds_of(group.ordered, quantiles) for group in runs.groups]
    edges = runs.edges[np.cumsum([0, *map(len, runs.groups)])]
    return list(map(runs.at, places_beyond(runs.relative, edges, thresholds, quantiles)))


def find_inflations(runs: Runs, quantiles: Sequence[float]) -> list[list[float]]:
    """Return the inflation of each run beyond each quantile; see `Runs.inflations`."""
    return share_inflations(runs.cells, [(b.places, b.edges) for b in map(runs.beyond, quantiles)])


def joined_runs(runs: Sequence[Run]) -> Run:
    """Return several runs as one series, in their order; a single run is returned as it is, no run as an empty one.

    Times of sending are moved so that the runs follow each other: an episode does not outlive its run by more than
    the pause between two messages.
    """
    if not runs:
        return Run(np.empty(0))
    if len(runs) == 1:
        return runs[0]
    side_by_side = Runs.of(runs)
    values = side_by_side.values
    return (
        Run(values) if any(run.sent_ns is None for run in runs) else Run(values, side_by_side.times.joined_ns)
    )


def _steps_ns(times: Int64) -> Int64:
    """Return the time since the message before, for the first one the mean of the run."""
    if not len(times):
        return times
    step = int(times[-1] - times[0]) // max(1, len(times) - 1)
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

    def of_runs(self, runs: Runs) -> NDArray[np.float64]:
        """Return the statistic of each run, shape (runs,); a quantile by the median-unbiased definition.

        That is definition 8 of R. Hyndman and Y. Fan, "Sample quantiles in statistical packages", American
        Statistician 50, 1996. The summary's definition 7 is below the truth where few messages lie beyond the
        quantile, and a mean over runs does not cure that: from ten runs of 150 independent messages it leaves
        74 of 100 intervals of p99 with the truth inside, definition 8 leaves 94.
        """
        if self.quantile is None:
            return np.array([run.values.mean() for run in runs], np.float64)
        return runs.quantile(self.quantile)

    def of_run(self, run: Run) -> float:
        """Return the statistic of one run (`of_runs`)."""
        return float(self.of_runs(Runs([run]))[0])


MEAN = Statistic(None)


def quantile_at(ordered: Values, position: float) -> float:
    """Return the value of one series at a 1-based position between order statistics (`quantiles_at`)."""
    return float(quantiles_at(ordered, np.array([0, len(ordered)]), np.array([position]))[0])


def quantiles_at(
    ordered: Values, edges: NDArray[np.intp], positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the values of several series at 1-based positions between order statistics; infinite if one of the two is.

    Args:
        ordered: the values of each series, rising, series after series.
        edges: the first value of each series, which has at least one, and the number of all, shape (series + 1,).
        positions: are moved to the nearest order statistic if they lie outside, shape (..., series).

    Returns:
        The shape of `positions`.
    """
    first, count = edges[:-1], edges[1:] - edges[:-1]
    positions = np.minimum(np.maximum(positions, 1.0), count)
    below = positions.astype(np.intp)
    share = positions - below
    low = ordered[first + below - 1].astype(np.float64)
    high = ordered[first + np.minimum(below, count - 1)].astype(np.float64)
    is_between = (share > 0) & (low != high)
    np.subtract(high, low, where=is_between, out=high)
    np.multiply(high, share, where=is_between, out=high)
    np.add(low, high, where=is_between, out=low)
    return np.asarray(low, np.float64)
