"""The fit of two clocks told plainly: window after window, message after message, as the analysis computed it before 1.0.

What `analyzer/clocks` computes for all windows at once has to be the same to the nanosecond.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dds_trace.analyzer.clocks.fit import find_stretches
from dds_trace.analyzer.clocks.lines import CANDIDATES, DRIFT, OffsetIntervals
from dds_trace.analyzer.clocks.lines import ROUNDING_NS as _ROUNDING_NS
from dds_trace.analyzer.clocks.windows import HALF_MESSAGES, WINDOW_NS


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """All lines that agree with the messages of one window, by the corners of their set.

    A line is its slope and its height at `centre`. A line of `slope[i]` has a height from `low[i]` to `high[i]`.
    """

    centre: float
    slope: np.ndarray
    low: np.ndarray
    high: np.ndarray

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

    def range_at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest height of any line at each time."""
        x = time - self.centre
        low = np.full(len(time), np.inf)
        high = np.full(len(time), -np.inf)
        for slope, bottom, top in zip(self.slope, self.low, self.high, strict=True):
            np.minimum(low, bottom + slope * x, out=low)
            np.maximum(high, top + slope * x, out=high)
        return low, high


def _tightest(points: OffsetIntervals, height: np.ndarray) -> list[int]:
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


def find_windows(points: OffsetIntervals, start: int, stop: int):
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


def _halved(points: OffsetIntervals, start: int, stop: int, lines: Lines | None):
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


@dataclass(frozen=True, slots=True)
class _Best:
    """The instant of a window at which its lines are closest together.

    Attributes:
        time: the instant.
        offset: middle of the lines at that instant.
        bound: half of their distance at that instant.
    """

    time: float
    offset: float
    bound: float

    @classmethod
    def of(cls, window: OffsetIntervals, lines: Lines) -> _Best:
        time = np.linspace(window.time[0], window.time[-1], 17)
        low, high = lines.range_at(time)
        middle, half = (low + high) / 2, (high - low) / 2
        best = int(half.argmin())
        return cls(time=float(time[best]), offset=float(middle[best]), bound=float(half[best]))


def plain_fit(publish_ns, relay_in_ns, relay_out_ns, receive_ns):
    """Offset and bound of each message, and the knots of each segment as (at_ns, offset_ns, bound_ns)."""
    out_ns, back_ns = relay_in_ns - publish_ns, relay_out_ns - receive_ns
    rtt_ns = receive_ns - publish_ns
    half_way_ns = publish_ns + rtt_ns // 2
    order = np.argsort(half_way_ns, kind="stable")
    time_origin_ns, offset_origin_ns = int(half_way_ns[order[0]]), int(out_ns[order[0]])
    slack = (DRIFT / 2 * rtt_ns)[order]
    points = OffsetIntervals(
        (half_way_ns - time_origin_ns)[order].astype(np.float64),
        (back_ns - offset_origin_ns)[order] - slack,
        (out_ns - offset_origin_ns)[order] + slack,
    )
    low, high = points.lower.copy(), points.upper.copy()
    segments = []
    for start, stop in find_stretches(points):
        stretch = points.part(start, stop)
        knots = []
        for begin, end, lines in find_windows(stretch, 0, len(stretch)):
            window = stretch.part(begin, end)
            lowest, highest = lines.range_at(window.time)
            low[start + begin : start + end] = np.maximum(lowest, window.lower)
            high[start + begin : start + end] = np.minimum(highest, window.upper)
            best = _Best.of(window, lines)
            knots.append(
                (
                    time_origin_ns + round(best.time),
                    offset_origin_ns + round(best.offset),
                    int(np.ceil(best.bound + 0.5)),
                )
            )
        if knots:
            segments.append(knots)
    alone = low > high
    low[alone], high[alone] = points.lower[alone], points.upper[alone]
    offset_ns, bound_ns = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    offset_ns[order] = np.rint((low + high) / 2).astype(np.int64) + offset_origin_ns
    bound_ns[order] = np.ceil((high - low) / 2 + 0.5).astype(np.int64)
    return offset_ns, bound_ns, segments
