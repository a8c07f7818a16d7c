"""Straight lines that agree with messages: stretches without a step, and all lines through a window.

The geometry of `analyzer/clocks/fit.py`, in floats whose origin was subtracted in int64.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterator

Float64 = NDArray[np.float64]

DRIFT_LIMIT_PPB = 500_000
"""Largest drift: Linux slews a clock by at most 500 ppm (adjtimex(2)); quartz is off by less than 100 ppm."""

WINDOW_NS = 10_000_000_000
"""Length of a window: crystals wander by well under 0.1 ppm in ten seconds, and 10 Hz gives 100 messages to choose from."""

CANDIDATES = 32
"""Messages of a window that constrain its lines, per direction. Fewer constraints can only widen the bound."""

HALF_MESSAGES = 16
"""Messages from which on a half of a window is asked: of fewer none may have been fast both ways, and their middle is a guess."""

DRIFT = DRIFT_LIMIT_PPB / 1e9
"""Largest drift in ns per ns."""

_BLOCK = 4096
"""Messages that are searched for a step at once."""

_MESSAGES_AFTER_STEP = 64
"""Messages after a step that tell which messages before it they cannot explain."""

_ROUNDING_NS = 1e-3
"""Tolerance of the check of lines against points, far below the nanosecond that is reported."""


@dataclass(frozen=True, slots=True, eq=False)
class OffsetIntervals:
    """Bounds on theta by each message alone: between `lower` and `upper` at `time`; without origins, so floats are exact."""

    time: Float64
    lower: Float64
    upper: Float64

    def part(self, start: int, stop: int) -> OffsetIntervals:
        """Return the messages from `start` to `stop` (not included)."""
        return OffsetIntervals(self.time[start:stop], self.lower[start:stop], self.upper[start:stop])

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """All lines that agree with the messages of one window, by the corners of their set.

    A line is its slope and its height at `centre`. A line of `slope[i]` has a height from `low[i]` to `high[i]`.
    """

    centre: float
    slope: Float64
    low: Float64
    high: Float64

    @classmethod
    def through(cls, points: OffsetIntervals) -> Lines | None:
        """Return the lines below every upper and above every lower end, no steeper than `DRIFT`; None if there is no line."""
        above, below = _tightest(points, points.upper), _tightest(points, -points.lower)
        centre = float(points.time[len(points) // 2])
        x, upper = points.time[above] - centre, points.upper[above]
        y, lower = points.time[below] - centre, points.lower[below]
        # The corners of the set lie where two constraints meet, so each has the slope through two of the points.
        time, height = np.concatenate([x, y]), np.concatenate([upper, lower])
        run = time[:, None] - time[None, :]
        rise = height[:, None] - height[None, :]
        gentle = np.abs(rise) < DRIFT * run  # half of the pairs (run > 0), none with equal times
        slope = np.concatenate([rise[gentle] / run[gentle], [-DRIFT, DRIFT]])
        high = (upper - slope[:, None] * x).min(axis=1)
        low = (lower - slope[:, None] * y).max(axis=1)
        possible = high >= low - _ROUNDING_NS
        if not possible.any():
            return None
        # Between the gentlest and the steepest, only the slope of an edge of one of the hulls makes a corner.
        edge = np.eye(len(time), k=-1, dtype=np.bool_)
        edge[len(x), len(x) - 1] = False  # from one hull to the other
        corner = np.append(edge[gentle], [False, False])
        corner[np.where(possible, slope, np.inf).argmin()] = True
        corner[np.where(possible, slope, -np.inf).argmax()] = True
        corner &= possible
        return cls(centre, slope[corner], low[corner], high[corner])

    def range_at(self, time: Float64) -> tuple[Float64, Float64]:
        """Return the lowest and the highest height of any line at each time."""
        x = time - self.centre
        low = np.full(len(time), np.inf)
        high = np.full(len(time), -np.inf)
        for slope, bottom, top in zip(self.slope, self.low, self.high, strict=True):
            np.minimum(low, bottom + slope * x, out=low)
            np.maximum(high, top + slope * x, out=high)
        return low, high


def _tightest(points: OffsetIntervals, height: Float64) -> list[int]:
    """Return the indices of the points that a line must pass below: the lower convex hull of the window.

    Only the lowest point of each of `CANDIDATES` equal parts of the window counts; the hull is built from left
    to right (A. Andrew's monotone chain, 1979).
    """
    edges = np.linspace(0, len(points), min(CANDIDATES, len(points)) + 1).astype(np.intp).tolist()
    hull: list[int] = []
    for begin, end in pairwise(edges):
        new = begin + int(height[begin:end].argmin())
        while len(hull) > 1:
            first, last = hull[-2], hull[-1]
            rise_last = (height[last] - height[first]) * (points.time[new] - points.time[first])
            rise_new = (height[new] - height[first]) * (points.time[last] - points.time[first])
            if rise_last < rise_new:
                break
            hull.pop()
        hull.append(new)
    return hull


def find_stretches(points: OffsetIntervals) -> Iterator[tuple[int, int]]:
    """Yield start and stop of each stretch without a step.

    Messages around a step that agree with the clock before it and after it belong to no stretch.
    """
    start = 0
    while start < len(points):
        step = _first_out_of_reach(points, start)
        yield start, _last_surely_before(points, start, step)
        start = step


def _first_out_of_reach(points: OffsetIntervals, start: int) -> int:
    """Return the index of the first message that no drift up to `DRIFT` reaches from those since `start`."""
    lowest_top, highest_bottom = np.inf, -np.inf
    for begin in range(start, len(points), _BLOCK):
        part = points.part(begin, begin + _BLOCK)
        reach = DRIFT * part.time
        top = np.minimum.accumulate(np.concatenate([[lowest_top], part.upper - reach]))
        bottom = np.maximum.accumulate(np.concatenate([[highest_bottom], part.lower + reach]))
        out = (part.lower > top[:-1] + reach) | (part.upper < bottom[:-1] - reach)
        if out.any():
            return begin + int(out.argmax())
        lowest_top, highest_bottom = top[-1], bottom[-1]
    return len(points)


def _last_surely_before(points: OffsetIntervals, start: int, step: int) -> int:
    """Return the index after the last message before `step` that the clock after the step cannot explain."""
    if step == len(points):
        return step
    after, before = points.part(step, step + _MESSAGES_AFTER_STEP), points.part(start, step)
    top = (after.upper + DRIFT * after.time).min() - DRIFT * before.time
    bottom = (after.lower - DRIFT * after.time).max() + DRIFT * before.time
    foreign = np.flatnonzero((before.lower > top) | (before.upper < bottom))
    return start + int(foreign[-1]) + 1 if len(foreign) else step


def find_windows(points: OffsetIntervals, start: int, stop: int) -> Iterator[tuple[int, int, Lines]]:
    """Yield start, stop and lines of each window.

    A window is at most `WINDOW_NS` long, and halved until a line agrees with it and its halves do (`_is_bent`).
    """
    duration = points.time[stop - 1] - points.time[start]
    if duration > WINDOW_NS:
        edges = np.linspace(points.time[start], points.time[stop - 1], int(np.ceil(duration / WINDOW_NS)) + 1)
        cuts = [start, *(start + np.searchsorted(points.time[start:stop], edges[1:-1])).tolist(), stop]
        for begin, end in pairwise(cuts):
            if end > begin:
                yield from find_windows(points, begin, end)
        return
    yield from _halved(points, start, stop, Lines.through(points.part(start, stop)))


def _halved(
    points: OffsetIntervals, start: int, stop: int, lines: Lines | None
) -> Iterator[tuple[int, int, Lines]]:
    """Yield a window whose lines are known, or the windows of its halves if it has none or is bent."""
    middle = (start + stop) // 2
    if middle == start:  # one message; without a line its stamps contradict each other by more than rounding
        if lines is not None:
            yield start, stop, lines
        return
    halves = [(start, middle), (middle, stop)]
    if lines is not None and not any(_is_bent(lines, points.part(*half)) for half in halves):
        yield start, stop, lines
        return
    for half in halves:
        yield from _halved(points, *half, Lines.through(points.part(*half)))


def _is_bent(lines: Lines, half: OffsetIntervals) -> bool:
    """Return whether a half of a window knows an offset that the window's own bound leaves out.

    A clock that bends within the window leaves few lines that respect every message, so the window's bound gets small
    where it is wrong. The half is asked at the instant of the message that bounds the offset best. It has fewer messages
    to respect, so its bound is never the smaller one: halving widens.
    """
    if len(half) < HALF_MESSAGES:
        return False
    tightest = int((half.upper - half.lower).argmin())
    instant = half.time[tightest : tightest + 1]
    (low,), (high,) = lines.range_at(instant)
    # The middles part by at most the difference of the bounds, and the half's is at most the message's own.
    if half.upper[tightest] - half.lower[tightest] <= 2 * (high - low):
        return False
    of_half = Lines.through(half)
    if of_half is None:
        return True
    (lowest,), (highest,) = of_half.range_at(instant)
    return bool(abs((lowest + highest) - (low + high)) > high - low + 2 * _ROUNDING_NS)
