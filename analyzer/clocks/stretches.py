"""Stretches of time in which neither of two clocks was stepped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .lines import DRIFT, OffsetIntervals

_BLOCKS = (1 << 12, 1 << 17)
"""Messages searched for a step at once: at first, and at most."""

_PART = 32

_MESSAGES_AFTER_STEP = 64
"""Messages after a step that decide which ones are surely before it."""


@dataclass(frozen=True, slots=True)
class _Limits:
    """The messages limit the offset at a later instant `t` to `bottom - DRIFT * t` .. `top + DRIFT * t`."""

    top: float = np.inf
    bottom: float = -np.inf

    def with_messages(self, points: OffsetIntervals) -> _Limits:
        if not len(points):
            return self
        reach = DRIFT * points.time
        return _Limits(
            min(self.top, float((points.upper - reach).min())), max(self.bottom, float((points.lower + reach).max()))
        )


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
    coarse, exact = _Limits(), _Limits()
    checked = start  # `exact` includes the messages before
    begin, size = start, _BLOCKS[0]
    while begin < len(points):
        part = points.part(begin, begin + size)
        is_settled, coarse = _check_parts(part, coarse)
        if not is_settled:
            exact = exact.with_messages(points.part(checked, begin))
            reach = DRIFT * part.time
            top = np.minimum.accumulate(np.append(exact.top, part.upper - reach))
            bottom = np.maximum.accumulate(np.append(exact.bottom, part.lower + reach))
            out = (part.lower > top[:-1] + reach) | (part.upper < bottom[:-1] - reach)
            if out.any():
                return begin + int(out.argmax())
            exact, checked = _Limits(float(top[-1]), float(bottom[-1])), begin + len(part)
        begin, size = begin + size, min(2 * size, _BLOCKS[1])
    return len(points)


def _check_parts(points: OffsetIntervals, before: _Limits) -> tuple[bool, _Limits]:
    """Return whether parts prove that drifts up to `DRIFT` reach every message, and limits after them.

    Limits may be tighter than exact: all messages of a part count as its first.
    """
    first = np.arange(0, len(points), _PART)
    least, most = np.minimum.reduceat(points.upper, first), np.maximum.reduceat(points.lower, first)
    begin = DRIFT * points.time[first]
    end = DRIFT * points.time[np.append(first[1:], len(points)) - 1]
    top = np.minimum.accumulate(np.append(before.top, least - end))
    bottom = np.maximum.accumulate(np.append(before.bottom, most + end))
    # Offsets of a part overlap, and are reached from the end of each earlier part.
    is_settled = np.all((most <= least) & (most - begin <= top[:-1]) & (least + begin >= bottom[:-1]))
    return bool(is_settled), _Limits(float(top[-1]), float(bottom[-1]))


def _last_surely_before(points: OffsetIntervals, start: int, step: int) -> int:
    if step == len(points):
        return step
    after, before = points.part(step, step + _MESSAGES_AFTER_STEP), points.part(start, step)
    top = (after.upper + DRIFT * after.time).min() - DRIFT * before.time
    bottom = (after.lower - DRIFT * after.time).max() + DRIFT * before.time
    foreign = np.flatnonzero((before.lower > top) | (before.upper < bottom))
    return start + int(foreign[-1]) + 1 if len(foreign) else step
