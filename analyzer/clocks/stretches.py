"""Stretches of time in which neither of two clocks was stepped."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .lines import DRIFT, OffsetIntervals

if TYPE_CHECKING:
    from collections.abc import Iterator

_BLOCKS = (1 << 12, 1 << 17)
"""Messages that are searched for a step at once: at the begin of a stretch, and at most. A clock that is slewed has steps close
to one another."""

_PART = 32
"""Messages that are looked at together first."""

_MESSAGES_AFTER_STEP = 64
"""Messages after a step that tell which messages before it they cannot explain."""


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
    begin, size = start, _BLOCKS[0]
    while begin < len(points):
        part = points.part(begin, begin + size)
        reach = DRIFT * part.time
        tops, bottoms = part.upper - reach, part.lower + reach
        if not _is_within_reach(part, lowest_top, highest_bottom):
            top = np.minimum.accumulate(np.append(lowest_top, tops))
            bottom = np.maximum.accumulate(np.append(highest_bottom, bottoms))
            out = (part.lower > top[:-1] + reach) | (part.upper < bottom[:-1] - reach)
            if out.any():
                return begin + int(out.argmax())
        lowest_top = min(lowest_top, float(tops.min()))
        highest_bottom = max(highest_bottom, float(bottoms.max()))
        begin, size = begin + size, min(2 * size, _BLOCKS[1])
    return len(points)


def _is_within_reach(points: OffsetIntervals, lowest_top: float, highest_bottom: float) -> bool:
    """Return whether a look at parts tells already that drifts up to `DRIFT` reach every message.

    Args:
        points: messages.
        lowest_top: least `upper - DRIFT * time` of the messages before.
        highest_bottom: greatest `lower + DRIFT * time` of these.
    """
    first = np.arange(0, len(points), _PART)
    least, most = np.minimum.reduceat(points.upper, first), np.maximum.reduceat(points.lower, first)
    begin = DRIFT * points.time[first]
    end = DRIFT * points.time[np.append(first[1:], len(points)) - 1]
    top = np.minimum.accumulate(np.append(lowest_top, least - end))[:-1]
    bottom = np.maximum.accumulate(np.append(highest_bottom, most + end))[:-1]
    # All offsets of a part overlap, and those of a later part are reached from the end of each earlier one.
    return bool(np.all((most <= least) & (most - begin <= top) & (least + begin >= bottom)))


def _last_surely_before(points: OffsetIntervals, start: int, step: int) -> int:
    """Return the index after the last message before `step` that the clock after the step cannot explain."""
    if step == len(points):
        return step
    after, before = points.part(step, step + _MESSAGES_AFTER_STEP), points.part(start, step)
    top = (after.upper + DRIFT * after.time).min() - DRIFT * before.time
    bottom = (after.lower - DRIFT * after.time).max() + DRIFT * before.time
    foreign = np.flatnonzero((before.lower > top) | (before.upper < bottom))
    return start + int(foreign[-1]) + 1 if len(foreign) else step
