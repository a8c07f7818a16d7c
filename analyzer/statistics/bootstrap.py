"""The block bootstrap: quantile and mean of samples that are drawn from a series in blocks of neighbours.

A difference or a ratio of two samples' percentiles has no order statistics. So whole blocks of neighbours are drawn
again and again (H. R. Kuensch, "The jackknife and the bootstrap for general stationary observations", Annals of
Statistics 17, 1989; circular as in D. Politis and J. Romano, 1992), of the length that `dependence_of` gives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .percentiles import Values

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

REPLICATES = 499
"""Samples that are drawn for one interval."""

SEED = 20_260_101
"""Seed of the draws, fixed so that equal input gives an equal report."""

_MOST_CELLS = 256
"""Pieces in which a series is resampled at most, so that the cost does not grow with its length."""

_LEVELS = 96
"""Values around the quantile that a replicate can take."""

_REPLICATES_AT_ONCE = 8
"""Rows of one matrix product: too few for BLAS to wake its threads, which wait for each other on busy cores."""

_EXACT_IN_FLOAT32 = 1 << 22
"""Messages up to which float32 counts exactly: it holds whole numbers up to 2**24, and a replicate has hardly more
messages than the series."""


def bootstrap_quantile(
    values: Values,
    quantile: float,
    block_messages: int = 1,
    *,
    replicates: int = REPLICATES,
    seed: int = SEED,
    ordered: Values | None = None,
) -> Float64:
    """Return the quantile of each of `replicates` samples that are drawn from a series in blocks.

    A block starts anywhere and the series is a circle, so that every message is as likely to be drawn as any
    other. A long series is resampled in pieces of `n / 256` messages, and a replicate takes one of 96 values of
    the sample around the quantile: the cost is that of sorting, whatever the length.

    Args:
        values: the series in the order of time, at least one value.
        quantile: between 0 and 1.
        block_messages: neighbours that are drawn together.
        replicates: samples to draw.
        seed: seed of the draws.
        ordered: the same values in rising order, if the caller has them.

    Returns:
        float64, shape (replicates,), in the order drawn.
    """
    levels = _levels(np.sort(values) if ordered is None else ordered, quantile, block_messages)
    level = np.searchsorted(levels, values, side="left")  # values above the last level count as len(levels)
    drawn = _draw_blocks(len(values), block_messages, replicates, seed)
    counts = np.bincount(drawn.cell * (len(levels) + 1) + level, minlength=drawn.cells * (len(levels) + 1))
    below = np.cumsum(_drawn_counts(drawn.weights, counts.reshape(drawn.cells, -1)), axis=1)
    reached = below[:, :-1] >= quantile * below[:, -1:] - 1e-6
    position = np.where(reached.any(axis=1), reached.argmax(axis=1), len(levels) - 1)
    return levels[position].astype(np.float64)


def bootstrap_mean(
    values: Values,
    block_messages: int = 1,
    *,
    replicates: int = REPLICATES,
    seed: int = SEED,
) -> Float64:
    """Return the mean of each of `replicates` samples; arguments and result as for `bootstrap_quantile`."""
    drawn = _draw_blocks(len(values), block_messages, replicates, seed)
    sums = np.bincount(drawn.cell, weights=values, minlength=drawn.cells)
    counts = np.bincount(drawn.cell, minlength=drawn.cells).astype(np.float64)
    weights = drawn.weights.astype(np.float64)
    means: Float64 = (weights @ sums) / (weights @ counts)
    return means


@dataclass(frozen=True, slots=True, eq=False)
class _DrawnBlocks:
    """A series cut into cells, and how often each replicate holds each cell.

    Attributes:
        cell: intp, shape (messages,), the cell of each message.
        cells: number of cells.
        weights: float32, whole numbers, shape (replicates, cells).
    """

    cell: NDArray[np.intp]
    cells: int
    weights: Float32


def _draw_blocks(n: int, block_messages: int, replicates: int, seed: int) -> _DrawnBlocks:
    cells = min(n, _MOST_CELLS)
    per_block = min(max(1, math.ceil(block_messages * cells / n)), cells)
    return _DrawnBlocks(np.arange(n) * cells // n, cells, _weights(cells, per_block, replicates, seed))


@lru_cache(maxsize=32)  # groups of a campaign are alike, and drawing is much of the work; half a MB each
def _weights(cells: int, per_block: int, replicates: int, seed: int) -> Float32:
    """Draw blocks of `per_block` cells; return how often each replicate holds each cell, shape (replicates, cells)."""
    draws = math.ceil(cells / per_block)
    picked = np.random.default_rng(seed).integers(cells, size=(replicates, draws))
    picked += np.arange(replicates)[:, None] * cells
    starts = np.bincount(picked.ravel(), minlength=replicates * cells).reshape(replicates, cells)
    # A cell is in every block that starts on it or up to `per_block - 1` cells before it.
    circle = np.concatenate([starts[:, cells - per_block + 1 :], starts], axis=1)
    running = np.cumsum(np.concatenate([np.zeros_like(circle[:, :1]), circle], axis=1), axis=1)
    weights: Float32 = (running[:, per_block:] - running[:, :-per_block]).astype(np.float32)
    weights.flags.writeable = False
    return weights


def _levels(ordered: Values, quantile: float, block_messages: int) -> Values:
    """Return the values that a resampled quantile can reach: five standard errors of its rank either way."""
    n = len(ordered)
    reach = 5 * math.sqrt(n * quantile * (1 - quantile) * block_messages) + 8
    first, last = max(0, math.floor(n * quantile - reach)), min(n - 1, math.ceil(n * quantile + reach))
    picked = np.unique(np.linspace(first, last, _LEVELS).round().astype(np.intp))
    levels: Values = np.unique(ordered[picked])
    return levels


def _drawn_counts(weights: Float32, counts: NDArray[np.intp]) -> Float64:
    """Return `weights @ counts`, whole numbers, computed `_REPLICATES_AT_ONCE` rows at a time."""
    exact = np.float32 if counts.sum() < _EXACT_IN_FLOAT32 else np.float64
    typed, drawn = counts.astype(exact), np.empty((len(weights), counts.shape[1]), exact)
    for first in range(0, len(weights), _REPLICATES_AT_ONCE):
        rows = slice(first, first + _REPLICATES_AT_ONCE)
        np.matmul(weights[rows], typed, out=drawn[rows])
    return drawn.astype(np.float64)
