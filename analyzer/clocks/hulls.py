"""Convex hulls of many windows at once: what all lines of a window pass below, or above.

Rows of a matrix are windows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Intp = NDArray[np.intp]

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
    left, corner = np.arange(rows), corners[0]
    column = np.arange(columns)
    while last and len(left):
        at = np.arange(len(left)), corner
        run, slope = time - time[at][:, None], height - height[at][:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope /= run
        # Of two points at one time, the lower comes next (-inf), or none (inf; nan if equal).
        np.fmin(slope, np.inf, out=slope)
        np.copyto(slope, np.inf, where=column <= corner[:, None])
        corner = last - slope[:, ::-1].argmin(axis=1)
        following = np.full(rows, last)
        following[left] = corner
        corners.append(following)
        goes_on = corner < last
        if not goes_on.all():
            left, corner, time, height = left[goes_on], corner[goes_on], time[goes_on], height[goes_on]
    return np.stack(corners, axis=1)
