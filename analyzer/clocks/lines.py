"""All straight lines that agree with the messages of a window, for many windows at once.

The geometry of `fit.py`, in floats from an origin that was subtracted in int64. Rows of every matrix are windows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.units import DRIFT_LIMIT_PPB

CANDIDATES = 32
"""Messages that constrain the lines of a window, per direction. Fewer can only widen the bound."""


def part_edges(start: Intp, stop: Intp) -> Intp:
    """Cut windows into `CANDIDATES` parts of equal length, or one for each message of a shorter window.

    Returns:
        Edges of the parts, shape (windows, parts + 1); a shorter window ends in empty parts.
    """
    count = stop - start
    parts = min(CANDIDATES, int(count.max()))
    length = count / np.minimum(count, CANDIDATES)
    inside = (np.arange(parts + 1) * length[:, None]).astype(np.intp)
    edges: Intp = start[:, None] + np.minimum(inside, count[:, None])
    return edges


def lowest_of_parts(height: Float64, edges: Intp) -> Intp:
    """Return the first of the lowest points of each part: messages, shape (windows, parts).

    Args:
        height: of every message.
        edges: shape (windows, parts + 1), ascending. An empty part takes the point before it.
    """
    begins = edges.ravel()
    lengths = np.diff(begins, append=max(len(height), int(begins[-1])))
    is_full = lengths > 0
    first, lengths = (begins[is_full], lengths[is_full])  # messages between two windows are a part here
    lowest = np.minimum.reduceat(height, first)
    at = np.flatnonzero(height[first[0] :] == np.repeat(lowest, lengths)) + first[0]
    if len(at) > len(first):  # equal points in a part
        part = np.repeat(np.arange(len(first)), lengths)[at - first[0]]
        at = at[np.diff(part, prepend=-1) > 0]
    index = np.maximum(np.cumsum(is_full) - 1, 0)
    lowest_of: Intp = at[index].reshape(edges.shape)[:, :-1]
    return lowest_of


def lower_hulls(time: Float64, height: Float64) -> Intp:
    """Return the lower convex hull of the points of each row, from left to right.

    Gift wrapping (R. A. Jarvis, 1973): the gentlest slope to a later point leads to the next corner, the last of points
    on one line.

    `time`, not falling, and `height` have the shape (rows, points); the result has columns of the corners, the last repeated where
    a row has fewer.
    """
    rows, columns = time.shape
    last = columns - 1
    corners = [np.zeros(rows, np.intp)]
    open_rows, corner = np.arange(rows), corners[0]
    column = np.arange(columns)
    while last and len(open_rows):
        at = np.arange(len(open_rows)), corner
        run, slope = time - time[at][:, None], height - height[at][:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope /= run
        # Of two points at one time, the lower comes next (-inf), or none (inf; nan if equal).
        np.fmin(slope, np.inf, out=slope)
        np.copyto(slope, np.inf, where=column <= corner[:, None])
        corner = last - slope[:, ::-1].argmin(axis=1)
        following = np.full(rows, last)
        following[open_rows] = corner
        corners.append(following)
        goes_on = corner < last
        if not goes_on.all():
            open_rows, corner, time, height = open_rows[goes_on], corner[goes_on], time[goes_on], height[goes_on]
    return np.stack(corners, axis=1)


Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Intp = NDArray[np.intp]
Bools = NDArray[np.bool_]

DRIFT = DRIFT_LIMIT_PPB / 1e9
"""Largest drift, ns per ns."""

ROUNDING_NS = 1e-3
"""Tolerance of lines against points, far below the reported nanosecond."""


@dataclass(frozen=True, slots=True, eq=False)
class OffsetIntervals:
    """Bounds on theta by each message: between `lower` and `upper` at `time`; origins subtracted, so floats are exact."""

    time: Float64
    lower: Float64
    upper: Float64

    def part(self, start: int, stop: int) -> OffsetIntervals:
        return OffsetIntervals(self.time[start:stop], self.lower[start:stop], self.upper[start:stop])

    def take(self, messages: Intp) -> OffsetIntervals:
        return OffsetIntervals(self.time[messages], self.lower[messages], self.upper[messages])

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """The greatest heights of each window's lines: straight pieces in order of time.

    Attributes:
        slope: shape (windows, pieces), ascending; repeated where a window has fewer pieces.
        height: of each piece at the window's centre.
        breaks: shape (windows, pieces - 1): the message at which each piece but the last ends and the next begins.
    """

    slope: Float64
    height: Float64
    breaks: Intp

    @classmethod
    def of(cls, corners: Intp, time: Float64, height: Float64, steepness: Float64, at_centre: Float64) -> Boundary:
        """Return the boundary of the lines below some points.

        `corners`, shape (windows, corners), are messages of the lower hull of the points, `time` (the centre being
        zero) and `height` theirs, `steepness` as in `Lines`, `at_centre` the greatest heights of the gentlest and
        steepest line at the centre.
        """
        run, rise = np.diff(time), np.diff(height)
        with np.errstate(divide="ignore", invalid="ignore"):
            edge = np.where(run > 0, rise / run, np.where(rise < 0, -np.inf, np.inf))
        gentlest, steepest = steepness[:, :1], steepness[:, 1:]
        first = np.count_nonzero(edge < gentlest, axis=1, keepdims=True)
        after = np.maximum(np.count_nonzero(edge <= steepest, axis=1, keepdims=True), first)
        number = np.arange(corners.shape[1])
        is_piece = (number[:-1] >= first) & (number[:-1] < after)
        edge = np.where(is_piece, edge, gentlest)
        return cls(
            np.concatenate([gentlest, edge, steepest], axis=1),
            np.concatenate([at_centre[:, :1], least_height(time, height, edge), at_centre[:, 1:]], axis=1),
            np.take_along_axis(corners, np.clip(number, first, after), axis=1),
        )

    def reach(self, time: Float64) -> Float64:
        """Return the greatest height of any line at `time`: shape (windows, instants), the centre being zero."""
        reached = self.height[:, :1] + self.slope[:, :1] * time
        for piece in range(1, self.slope.shape[1]):
            row = slice(piece, piece + 1)
            np.maximum(reached, self.height[:, row] + self.slope[:, row] * time, out=reached)
        return reached

    def take(self, windows: Bools | Intp | slice) -> Boundary:
        return Boundary(self.slope[windows], self.height[windows], self.breaks[windows])


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """All lines that agree with the messages of each window, by the corners of their set.

    Attributes:
        exist: whether a window has any; else its other values have no meaning.
        steepness: shape (windows, 2): slope of the gentlest and of the steepest line.
    """

    exist: Bools
    centre: Float64
    steepness: Float64
    above: Boundary
    below: Boundary

    @classmethod
    def through(cls, points: OffsetIntervals, start: Intp, stop: Intp) -> Lines:
        """Return the lines below every upper and above every lower end of each window, no steeper than `DRIFT`.

        A window is the messages from `start` to `stop` (not included); windows ascend and do not overlap.
        """
        centre = points.time[start + (stop - start) // 2]
        edges = part_edges(start, stop)
        (above, x, upper), (below, y, lower) = _hulls(points, edges, centre)
        # The slope through the point above a line and the point below limits the line: from above if the first comes later,
        # from below if it comes earlier. The tightest limits are the slopes of the steepest and the gentlest line.
        run = x[:, :, None] - y[:, None, :]
        rise = upper[:, :, None] + lower[:, None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = rise / run
        steepest = np.minimum(np.where(run > 0, slope, DRIFT).min(axis=(1, 2)), DRIFT)
        gentlest = np.maximum(np.where(run < 0, slope, -DRIFT).max(axis=(1, 2)), -DRIFT)
        steepness = np.stack([gentlest, steepest], axis=1)
        high, low = least_height(x, upper, steepness), least_height(y, lower, -steepness)
        possible = high + low >= -ROUNDING_NS
        # Where rounding leaves one of the two, it is both.
        stand_in = possible[:, ::-1] & ~possible
        steepness, high, low = (np.where(stand_in, pair[:, ::-1], pair) for pair in (steepness, high, low))
        return cls(
            possible[:, 0] | possible[:, 1],
            centre,
            steepness,
            Boundary.of(above, x, upper, steepness, high),
            Boundary.of(below, y, lower, -steepness[:, ::-1], low[:, ::-1]),
        )

    def range_at(self, time: Float64) -> tuple[Float64, Float64]:
        """Return the lowest and the highest height of any line at `time`: shape (windows, instants)."""
        x = time - self.centre[:, None]
        return -self.below.reach(x), self.above.reach(x)

    def take(self, windows: Bools | Intp | slice) -> Lines:
        return Lines(
            self.exist[windows],
            self.centre[windows],
            self.steepness[windows],
            self.above.take(windows),
            self.below.take(windows),
        )


def least_height(time: Float64, height: Float64, slope: Float64) -> Float64:
    """Return the height at zero of the highest line of each slope below all points.

    `time` and `height` have the shape (windows, points), `slope` and the result (windows, slopes).
    """
    least: Float64 = (height[:, None, :] - slope[:, :, None] * time[:, None, :]).min(axis=2)
    return least


def _hulls(points: OffsetIntervals, edges: Intp, centre: Float64) -> Iterator[tuple[Intp, Float64, Float64]]:
    """Yield messages, instants from the centre and heights of each window's hull: of upper, then of negated lower ends."""
    heights = points.upper, -points.lower
    lowest = [lowest_of_parts(height, edges) for height in heights]
    lowest_pair = np.concatenate(lowest)
    # Both at once: a step costs little more for twice as many rows.
    corners = lower_hulls(
        points.time[lowest_pair], np.concatenate([h[at] for h, at in zip(heights, lowest, strict=True)])
    )
    for height, at, columns in zip(heights, lowest, np.split(corners, 2), strict=True):
        is_last = (columns == columns[:, -1:]).all(axis=0)
        columns_at = np.take_along_axis(at, columns[:, : np.count_nonzero(~is_last) + 1], axis=1)
        yield columns_at, points.time[columns_at] - centre[:, None], height[columns_at]
