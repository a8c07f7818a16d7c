"""How many independent messages a series of dependent ones is worth, and how many episodes a rare event came in.

The variance of a share in a dependent series is set by its slowest movements, so it is estimated from the projections
of the series on the first cosines of the run (U. Mueller, Journal of Business & Economic Statistics 32, 2014; E.
Lazarus, D. Lewis, J. Stock and M. Watson, the same journal 36, 2018). Dependence up to a twelfth of the run counts in
full.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Indices = NDArray[np.intp]


COSINES = 12
"""More of them narrow the interval (by Student's t) and miss longer dependence."""

EPISODE_GAP_SHARE = 0.05
"""Two rare events closer than this share of their mean distance are one episode."""

LEAST_GAP = 1.5
"""Messages; with 1, a sender's jitter would cut a burst in pieces."""

_MOST_CELLS = 1024  # of neighbours; the shortest cosine has 170 of them in a period

_MOST_CACHED = 1 << 16  # messages

_MANY = 20
"""Messages a cell from which on a search is quicker."""


def long_run_variance(series: NDArray[Any]) -> float:
    """Return n times the variance of the mean of at least `2 * COSINES` values in the order of time.

    `(2 / n) sum_j (sum_t x_t cos(pi j (t - 1/2) / n))^2 / COSINES`, j = 1 ... COSINES.
    """
    n = len(series)
    cells = min(n, _MOST_CELLS)
    sums = np.add.reduceat(series.astype(np.float64), _starts(n, cells))
    centred = sums - series.mean() * _widths(n, cells)
    return float(_variances(_projections(centred[None, :]), np.array([[n]]))[0, 0])


def share_inflation(indices: Indices, messages: int) -> float:
    """Return the variance of a share of messages divided by the variance of as many independent ones.

    1 without events, with nothing but events, and in fewer than `2 * COSINES` messages. `indices` ascend.
    """
    if not messages:
        return 1.0
    cells = cells_of([messages])
    return share_inflations(cells, cells.counts(indices), np.array([[0, len(indices)]]))[0][0]


@dataclass(frozen=True, eq=False)
class Cells:
    lengths: tuple[int, ...]
    widths: Int64
    offsets: Indices

    def counts(self, indices: Indices, groups: int = 1) -> Indices:
        """Return the messages in each cell, shape (groups, cells); `indices` are of one group after the other."""
        cells, messages = len(self.widths), sum(self.lengths)
        if groups == 1 and len(indices) > _MANY * cells:
            return np.diff(indices.searchsorted(self._bounds))[None, :]
        group = indices // messages if groups > 1 else 0
        in_cell = self._cell_of_message[indices - group * messages] + group * cells
        return np.bincount(in_cell, minlength=groups * cells).reshape(groups, cells)

    @cached_property
    def _bounds(self) -> Indices:
        return np.concatenate([[0], np.cumsum(self.widths)])

    @cached_property
    def _cell_of_message(self) -> NDArray[np.int32]:
        return np.repeat(np.arange(len(self.widths), dtype=np.int32), self.widths)

    @cached_property
    def messages(self) -> Int64:
        return np.maximum(self.lengths, 1)[:, None]

    @cached_property
    def blocks(self) -> tuple[tuple[slice, slice], ...]:
        counts = self.offsets[1:] - self.offsets[:-1]
        first = [0, *(np.flatnonzero(counts[1:] != counts[:-1]) + 1).tolist(), len(counts)]
        offsets = self.offsets.tolist()
        return tuple((slice(start, end), slice(offsets[start], offsets[end])) for start, end in pairwise(first))

    @cached_property
    def projections(self) -> tuple[Float64, ...]:
        return tuple(
            _projections(self.widths[cells].reshape(series.stop - series.start, -1).astype(np.float64))
            for series, cells in self.blocks
        )


def cells_of(lengths: Sequence[int]) -> Cells:
    make = _cells_of if sum(lengths) <= _MOST_CACHED else _cells_of.__wrapped__
    return make(tuple(lengths))


@lru_cache(maxsize=16)
def _cells_of(lengths: tuple[int, ...]) -> Cells:
    cells = [min(messages, _MOST_CELLS) for messages in lengths]
    widths = np.concatenate(list(map(_widths, lengths, cells)))
    return Cells(lengths, widths, np.cumsum([0, *cells]))


def share_inflations(cells: Cells, counts: Indices, offsets: Indices) -> list[list[float]]:
    """Return `share_inflation` of each series, for each of some subsets of their messages.

    `counts`: of each subset its `Cells.counts`; `offsets`: the first of its messages in each series, and the number of all.
    """
    in_cells: Float64 = counts.astype(np.float64)
    shares = (offsets[:, 1:] - offsets[:, :-1])[..., None] / cells.messages
    variances = np.empty_like(shares)
    for (series, in_series), projections in zip(cells.blocks, cells.projections, strict=True):
        in_block = in_cells[:, in_series].reshape(len(counts), len(projections), -1)
        centred = _projections(in_block) - shares[:, series] * projections
        variances[:, series] = _variances(centred, cells.messages[series])
    independent = shares * (1 - shares)
    is_comparable = (cells.messages >= 2 * COSINES) & (independent > 0)
    inflations = np.divide(variances, independent, out=np.ones_like(shares), where=is_comparable)
    rows: list[list[float]] = inflations[..., 0].tolist()
    return rows


def _projections(sums: Float64) -> Float64:
    return np.asarray(sums @ _cosines(sums.shape[-1]).T)


def _variances(projections: Float64, messages: Int64) -> Float64:
    """Return n times the variance of the mean of series, shape (..., series, 1), from centred projections."""
    squares = np.add.reduce(projections * projections, axis=-1, keepdims=True)
    return np.asarray(2 / messages * (squares / COSINES))


@lru_cache(maxsize=64)
def _starts(messages: int, cells: int) -> Int64:
    starts = np.arange(cells, dtype=np.int64) * messages // cells
    starts.flags.writeable = False
    return starts


@lru_cache(maxsize=64)
def _widths(messages: int, cells: int) -> Int64:
    widths = np.diff(_starts(messages, cells), append=messages)
    widths.flags.writeable = False
    return widths


@lru_cache(maxsize=64)
def _cosines(cells: int) -> Float64:
    centres = (np.arange(cells) + 0.5) / cells
    waves = np.cos(np.pi * np.arange(1, COSINES + 1)[:, None] * centres)
    waves.flags.writeable = False
    return np.asarray(waves)


def mean_distance(sent_ns: Int64) -> float:
    return float(sent_ns[-1] - sent_ns[0]) / max(1, len(sent_ns) - 1) or 1.0


def positions_of(indices: Indices, sent_ns: Int64 | None = None) -> Float64:
    """Return when messages of a series were sent, float64, in mean distances; `sent_ns` None for evenly spaced ones."""
    if sent_ns is None or not len(sent_ns):
        return indices.astype(np.float64)
    return np.asarray((sent_ns[indices] - sent_ns[0]) / mean_distance(sent_ns))


def episode_ends(positions: Float64, gaps: Float64 | float, offsets: Indices | None = None) -> Indices:
    """Return the index of the last event of each episode; one ends if the next event is farther away than the gap.

    Positions, shape (events,), ascend in each series; a gap is one number, or one for each event; `offsets` are the
    first event of each series and the number of all.
    """
    if not len(positions):
        return np.empty(0, np.intp)
    is_end = np.ones(len(positions), np.bool_)
    limits = gaps if isinstance(gaps, float) else gaps[:-1]
    np.greater(positions[1:] - positions[:-1], limits, out=is_end[:-1])
    if offsets is not None:
        is_end[offsets[1:] - 1] = True  # index -1, of a leading series without events, is an end anyway
    return is_end.nonzero()[0]


def episode_sizes(indices: Indices, messages: int) -> Int64:
    """Return the number of events in each episode of a series.

    Runs declustering (R. Smith and I. Weissman, JRSS B 56, 1994), with a gap of `EPISODE_GAP_SHARE`.
    """
    return sizes_between(episode_ends(positions_of(indices), gap_of(len(indices), messages, EPISODE_GAP_SHARE)))


def gap_of(events: int, messages: int, share: float) -> float:
    return max(share * messages / events, LEAST_GAP) if events else np.inf


def sizes_between(ends: Indices) -> Int64:
    sizes = ends + 1
    sizes[1:] -= ends[:-1] + 1
    return sizes


def gaps_of(events: Indices, messages: Indices, share: float) -> Float64:
    gaps = np.full(len(events), np.inf)
    np.divide(share * messages, events, out=gaps, where=events > 0)
    return np.asarray(np.maximum(gaps, LEAST_GAP))


@lru_cache(maxsize=4096)
def independent_squares(events: int, messages: int, gap: float) -> float:
    """Return the mean squared size over the mean size of the episodes of independent events.

    An event is followed by another within a gap of g messages with `p = 1 - (1 - share)^g`, so sizes are geometric:
    `(1 + p) / (1 - p)`.
    """
    if not 0 < events < messages:
        return 1.0
    followed = 1 - (1 - events / messages) ** math.floor(gap)
    return (1 + followed) / (1 - followed)


def equal_episodes(events: int, squares: float) -> int | None:
    """Return how many episodes of equal size make a count vary as much; None without an event.

    A compound Poisson count has the relative error of `(sum sizes)^2 / sum sizes^2` equal episodes; in `squares` each size is
    divided by `independent_squares`.
    """
    return round(min(events, events**2 / squares)) if events else None
