"""Windows of time in which the clocks of two devices part along a straight line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from .lines import ROUNDING_NS, Bools, Boundary, Float64, Intp, Lines, OffsetIntervals, lowest_of_parts

WINDOW_NS = 10_000_000_000
"""Length of a window: crystals wander by well under 0.1 ppm in ten seconds, and 10 Hz gives 100 messages."""

HALF_MESSAGES = 16
"""Least messages of a checked half: of fewer, perhaps none was fast both ways."""

_BLOCK_MESSAGES = 1 << 18
_BLOCK_WINDOWS = 1 << 12
"""Messages and windows processed together, unless one window has more."""

_CACHED_MESSAGES = 1 << 15
"""Messages narrowed together, in the cache of a core."""

_INSTANTS = 17
"""Instants of a window, first to last message, at which its bound is computed."""


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Fitted windows; one element a window, or one row.

    Attributes:
        steepness: shape (windows, 2): smallest and largest slope.
        first: shape (windows, 2): middle and half distance of the lines at the first message.
    """

    start: Intp
    stop: Intp
    time: Float64
    offset: Float64
    bound: Float64
    steepness: Float64
    first: Float64
    last: Float64

    @classmethod
    def of(cls, points: OffsetIntervals, start: Intp, stop: Intp, lines: Lines) -> Windows:
        begin, end = points.time[start], points.time[stop - 1]
        time = np.arange(_INSTANTS) * ((end - begin) / (_INSTANTS - 1))[:, None] + begin[:, None]
        time[:, -1] = end
        low, high = lines.range_at(time)
        middle, half = (low + high) / 2, (high - low) / 2
        best = np.arange(len(time)), half.argmin(axis=1)
        return cls(
            start,
            stop,
            time[best],
            middle[best],
            half[best],
            lines.steepness,
            np.stack([middle[:, 0], half[:, 0]], axis=1),
            np.stack([middle[:, -1], half[:, -1]], axis=1),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Windows]) -> Windows:
        if not parts:
            none, no_pairs = np.empty(0), np.empty((0, 2))
            no_messages = np.empty(0, np.intp)
            return cls(no_messages, no_messages, none, none, none, no_pairs, no_pairs, no_pairs)
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def take(self, windows: Intp) -> Windows:
        return Windows(*(getattr(self, field.name)[windows] for field in fields(self)))


def fit_windows(points: OffsetIntervals, stretches: Sequence[tuple[int, int]]) -> Windows:
    """Fit the lines of every window of some stretches, and narrow the bounds of `points` by them in place.

    A window is at most `WINDOW_NS` long, and halved until a line agrees with it and its halves do (`_are_bent`).
    Stretches, first message and message after the last, ascend; each is of one fit. Only the tightest messages shape
    the lines; one that no line reaches keeps its bounds.
    """
    fitted: list[Windows] = []
    if not stretches:
        return Windows.concatenate(fitted)
    start, stop = _cut(points.time, stretches)
    for first, after in _blocks(start, stop, _BLOCK_MESSAGES):
        begin, end = int(start[first]), int(stop[after - 1])
        block = _fit_levels(points.part(begin, end), start[first:after] - begin, stop[first:after] - begin)
        block = block.take(np.argsort(block.start))
        fitted.append(replace(block, start=block.start + begin, stop=block.stop + begin))
    return Windows.concatenate(fitted)


def _cut(time: Float64, stretches: Sequence[tuple[int, int]]) -> tuple[Intp, Intp]:
    starts: list[Intp] = []
    stops: list[Intp] = []
    for start, stop in stretches:
        cuts = np.array([start, stop])
        duration = time[stop - 1] - time[start]
        windows = int(np.ceil(duration / WINDOW_NS))
        if windows > stop - start:  # few messages, far apart: no array has the length of a time
            number = np.floor((time[start:stop] - time[start]) * (windows / duration))
            inside = start + 1 + np.flatnonzero(np.diff(number))
            cuts = np.unique(np.concatenate([cuts, inside]))
        elif windows > 1:
            edges = np.linspace(time[start], time[stop - 1], windows + 1)
            inside = start + np.searchsorted(time[start:stop], edges[1:-1])
            cuts = np.unique(np.concatenate([cuts, inside]))
        starts.append(cuts[:-1])
        stops.append(cuts[1:])
    return np.concatenate(starts), np.concatenate(stops)


def _blocks(start: Intp, stop: Intp, messages: int) -> Iterator[tuple[int, int]]:
    first = 0
    while first < len(start):
        last = int(np.searchsorted(stop, start[first] + messages, side="right"))
        after = min(max(last, first + 1), first + _BLOCK_WINDOWS)
        yield first, after
        first = after


def _fit_levels(points: OffsetIntervals, start: Intp, stop: Intp) -> Windows:
    """Fit windows, and halves of those that are bent or have no line (one message without is in none); narrow bounds."""
    fitted: list[Windows] = []
    origin: Intp | None = None  # of the remaining messages; None while these are all
    remaining = points
    while len(start):
        lines = Lines.through(remaining, start, stop)
        is_whole = lines.exist & ~_are_bent(remaining, start, stop, lines)
        if is_whole.any():
            whole, own_start, own_stop = lines.take(is_whole), start[is_whole], stop[is_whole]
            windows = Windows.of(remaining, own_start, own_stop, whole)
            span = slice(int(own_start[0]), int(own_stop[-1]))
            _narrow(remaining, own_start, own_stop, whole)
            if origin is not None:
                points.lower[origin[span]], points.upper[origin[span]] = remaining.lower[span], remaining.upper[span]
                windows = replace(windows, start=origin[own_start], stop=origin[own_stop - 1] + 1)
            fitted.append(windows)
        halved = ~is_whole & (stop - start > 1)
        middle = (start[halved] + stop[halved]) // 2
        start, stop = (np.stack(edges, axis=1).ravel() for edges in ((start[halved], middle), (middle, stop[halved])))
        lengths = stop - start
        messages: Intp = np.arange(lengths.sum()) + np.repeat(start - (np.cumsum(lengths) - lengths), lengths)
        remaining = remaining.take(messages)
        origin = messages if origin is None else origin[messages]
        stop = np.cumsum(stop - start)
        start = np.concatenate([[0], stop[:-1]]).astype(np.intp)[: len(stop)]
    return Windows.concatenate(fitted)


def _are_bent(points: OffsetIntervals, start: Intp, stop: Intp, lines: Lines) -> Bools:
    """Return which windows have a half with its offset outside the window's own bound.

    Few lines respect every message of a clock that bends, so the bound is small where it is wrong. The half is checked at
    its tightest message; with fewer messages to respect, its bound is never smaller.
    """
    middle = (start + stop) // 2
    begins, ends = np.stack([start, middle], axis=1), np.stack([middle, stop], axis=1)
    is_checked = (ends - begins >= HALF_MESSAGES) & lines.exist[:, None]
    bent = np.zeros(len(start), np.bool_)
    if not is_checked.any():
        return bent
    width = points.upper - points.lower
    tightest = begins.copy()
    tightest[is_checked] = lowest_of_parts(width, np.stack([begins[is_checked], ends[is_checked]], axis=1))[:, 0]
    low, high = lines.range_at(points.time[tightest])
    # Middles part by at most the difference of the bounds; the half's bound is at most the message's own.
    is_checked &= width[tightest] > 2 * (high - low)
    if not is_checked.any():
        return bent
    half = Lines.through(points, begins[is_checked], ends[is_checked])
    lowest, highest = (side[:, 0] for side in half.range_at(points.time[tightest[is_checked]][:, None]))
    low, high = low[is_checked], high[is_checked]
    disagrees = ~half.exist | (np.abs((lowest + highest) - (low + high)) > high - low + 2 * ROUNDING_NS)
    bent[np.nonzero(is_checked)[0][disagrees]] = True
    return bent


def _narrow(points: OffsetIntervals, start: Intp, stop: Intp, lines: Lines) -> None:
    following = np.append(start[1:], stop[-1])
    for first, after in _blocks(start, stop, _CACHED_MESSAGES):
        span = slice(first, after)
        window = slice(int(start[first]), int(following[after - 1]))
        edges, part = (start[span], stop[span], following[span]), lines.take(span)
        x = points.time[window] - np.repeat(part.centre, edges[2] - edges[0])
        low = _least(-points.lower[window], part.below, *edges, x)
        np.negative(low, out=low)
        high = _least(points.upper[window], part.above, *edges, x)
        none = low > high
        if none.any():
            low[none], high[none] = points.lower[window][none], points.upper[window][none]
        points.lower[window], points.upper[window] = low, high


def _least(heights: Float64, boundary: Boundary, start: Intp, stop: Intp, following: Intp, x: Float64) -> Float64:
    edges = np.concatenate([start[:, None], boundary.breaks + 1, stop[:, None], following[:, None]], axis=1)
    lengths = np.diff(edges).ravel()
    nothing = np.zeros((len(start), 1))  # a message between two windows keeps its own height
    least = np.repeat(np.concatenate([boundary.slope, nothing], axis=1), lengths)
    least *= x
    least += np.repeat(np.concatenate([boundary.height, nothing + np.inf], axis=1), lengths)
    np.minimum(least, heights, out=least)
    touched = boundary.breaks.ravel() - start[0]
    least[touched] = heights[touched]  # without the rounding of the lines that meet there
    return least
