"""One device's clock against another's: offset and drift over time from T1..T4, each with its bound.

Let `theta` be the relay's clock minus the ping's: `T4 - T2 <= theta <= T3 - T1` (RFC 5905, section 8). docs/explanation/clocks.md
has the two assumptions that give a slow message the interval of its fast neighbours (L. Zhang, Z. Liu, C. Xia, INFOCOM 2002; S.
Moon, P. Skelly, D. Towsley, INFOCOM 1999; Huygens, NSDI 2018; RFC 5905, section 10).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from .lines import DRIFT, Float64, Int64, OffsetIntervals
from .windows import Windows, fit_windows

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
    """Yield start and stop of each stretch without a step; messages around one that agree with both sides are in none."""
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


T = TypeVar("T", int, NDArray[np.int64])


_BLOCK_MESSAGES = 1 << 14


class ClockKnot(NamedTuple):
    """The instant of a window (ping's monotonic clock) with the smallest bound, and the relay's clock minus the ping's there."""

    at_ns: int
    offset_ns: int
    bound_ns: int


@dataclass(frozen=True, slots=True)
class ClockSegment:
    """A stretch of the ping's time without a step; `drift_ppb` is the mean rate at which the relay's clock gains."""

    start_ns: int
    end_ns: int
    messages: int
    at_ns: int
    offset_ns: int
    bound_ns: int
    drift_ppb: float
    drift_bound_ppb: float
    residual_ns: int
    knots: tuple[ClockKnot, ...]


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A jump of the relay's clock against the ping's: a clock that was set, a suspend, a reboot."""

    after_ns: int
    before_ns: int
    size_ns: int
    bound_ns: int


@dataclass(frozen=True, slots=True)
class ClockFit:
    """The relay's clock against the ping's, for one pair of devices.

    Attributes:
        same_clock: both sides are of one boot of one machine (without boot ids: have one name), and zero agrees with every
            message. One-way times are then exact.
        segments: in order of time; empty without a message that has all four stamps.
        relay_boot: the kernel's id of the boot of the relay's device; None if unknown.
    """

    ping_device: str
    relay_device: str
    boot: int
    same_clock: bool
    segments: tuple[ClockSegment, ...]
    steps: tuple[ClockStep, ...]
    relay_boot: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ClockOffsets:
    """Relay's clock minus ping's halfway between T1 and T2 of each message, and its largest error, int64."""

    offset_ns: Int64
    bound_ns: Int64


@dataclass(frozen=True, slots=True, eq=False)
class RelayedMessages:
    """The messages of one fit, in any order; `same_boot` (`boots.share_boot`) is None where names decide."""

    publish_ns: Int64
    relay_in_ns: Int64
    relay_out_ns: Int64
    receive_ns: Int64
    ping_device: str = "ping"
    relay_device: str = "relay"
    boot: int = 0
    relay_boot: str | None = None
    same_boot: bool | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """The messages of one fit in order of time, as bounds on theta.

    Their instants are halfway between T1 and T2, less the two origins. `order` is the index of each message in the
    input; None where the input is in order.
    """

    points: OffsetIntervals
    order: Int64 | None
    time_origin_ns: int
    offset_origin_ns: int
    same_clock: bool

    @classmethod
    def of(cls, messages: RelayedMessages, points: OffsetIntervals) -> _Points:
        ordered = cls._in_order(messages, points, None)
        if ordered is None:
            at_ns = _half_way(messages.publish_ns, messages.receive_ns - messages.publish_ns)
            ordered = cls._in_order(messages, points, np.argsort(at_ns, kind="stable"))
            assert ordered is not None
        return ordered

    @classmethod
    def _in_order(cls, messages: RelayedMessages, points: OffsetIntervals, order: Int64 | None) -> _Points | None:
        first = 0 if order is None else int(order[0])
        publish_ns, receive_ns = int(messages.publish_ns[first]), int(messages.receive_ns[first])
        time_origin_ns = last_ns = _half_way(publish_ns, receive_ns - publish_ns)
        offset_origin_ns = int(messages.relay_in_ns[first]) - publish_ns
        # Two devices may share a name, and a time namespace has its own clock: zero has to agree, too.
        same_clock = messages.same_boot
        if same_clock is None:
            same_clock = messages.ping_device == messages.relay_device
        for block in _blocks(len(messages.publish_ns)):
            chosen = block if order is None else order[block]
            published_ns, received_ns = messages.publish_ns[chosen], messages.receive_ns[chosen]
            out_ns = messages.relay_in_ns[chosen] - published_ns  # upper end of theta
            back_ns = messages.relay_out_ns[chosen] - received_ns  # lower end
            if (back_ns > out_ns).any():
                raise ValueError("a message spent more time in the relay than under way: leave it out of the fit")
            same_clock = same_clock and bool(out_ns.min() >= 0 and back_ns.max() <= 0)
            rtt_ns = received_ns - published_ns
            slack = DRIFT / 2 * rtt_ns  # clocks part on the way to the middle
            at_ns = _half_way(published_ns, rtt_ns)
            if at_ns[0] < last_ns or (at_ns[1:] < at_ns[:-1]).any():
                return None
            last_ns = int(at_ns[-1])
            at_ns -= time_origin_ns
            back_ns -= offset_origin_ns
            out_ns -= offset_origin_ns
            points.time[block] = at_ns
            lower, upper = points.lower[block], points.upper[block]
            lower[:], upper[:] = back_ns, out_ns
            lower -= slack
            upper += slack
        return cls(points, order, time_origin_ns, offset_origin_ns, same_clock)

    def offsets(self, offset_ns: Int64, bound_ns: Int64) -> ClockOffsets:
        """Return the offsets in the order of the input, if possible in these arrays."""
        if self.same_clock:
            zero = np.zeros(len(offset_ns), np.int64)
            return ClockOffsets(zero, zero)
        for block in _blocks(len(offset_ns)):
            low, high = self.points.lower[block], self.points.upper[block]
            value = low + high
            value /= 2
            offset_ns[block] = np.rint(value, out=value)
            np.subtract(high, low, out=value)
            value /= 2
            value += 0.5  # rounding
            bound_ns[block] = np.ceil(value, out=value)
        offset_ns += self.offset_origin_ns
        if self.order is not None:
            at = np.empty_like(self.order)
            at[self.order] = np.arange(len(at))
            offset_ns, bound_ns = offset_ns[at], bound_ns[at]
        return ClockOffsets(offset_ns, bound_ns)


def _blocks(messages: int) -> Iterator[slice]:
    return (slice(first, first + _BLOCK_MESSAGES) for first in range(0, messages, _BLOCK_MESSAGES))


def _half_way(publish_ns: T, rtt_ns: T) -> T:
    return publish_ns + (rtt_ns >> 1)


def fit_clocks(fits: Sequence[RelayedMessages]) -> list[tuple[ClockFit, ClockOffsets]]:
    """Fit the relay's clock against the ping's, if no `rtt < intermediate`; return each fit with the offset at each message."""
    edges = np.cumsum([0, *(len(messages.publish_ns) for messages in fits)]).tolist()
    # One array: numpy asks for large pages, which fill faster.
    points = OffsetIntervals(*np.empty((3, edges[-1])))
    all_points = [
        _Points.of(messages, points.part(first, after)) if after > first else None
        for messages, (first, after) in zip(fits, pairwise(edges), strict=True)
    ]
    stretches = [
        [(first + start, first + stop) for start, stop in find_stretches(fit_points.points)] if fit_points else []
        for fit_points, first in zip(all_points, edges[:-1], strict=True)
    ]
    windows = fit_windows(points, [stretch for fit_points in stretches for stretch in fit_points])
    offset_ns, bound_ns = np.empty((2, edges[-1]), np.int64)
    fitted = []
    for messages, fit_points, parts, (first, after) in zip(fits, all_points, stretches, pairwise(edges), strict=True):
        names = messages.ping_device, messages.relay_device, messages.boot
        if fit_points is None:
            nothing = np.empty(0, np.int64)
            no_fit = ClockFit(*names, False, (), (), messages.relay_boot)
            fitted.append((no_fit, ClockOffsets(nothing, nothing)))
            continue
        segments, steps = _segments(points.time, windows, parts, fit_points)
        fit = ClockFit(*names, fit_points.same_clock, segments, steps, messages.relay_boot)
        fitted.append((fit, fit_points.offsets(offset_ns[first:after], bound_ns[first:after])))
    return fitted


@dataclass(frozen=True, slots=True, eq=False)
class FittedWindows:
    """The windows of one fit, less the origins: `time` of each message in order, and `stretches` without a step."""

    time: Float64
    windows: Windows
    stretches: tuple[tuple[int, int], ...]
    time_origin_ns: int
    offset_origin_ns: int
    same_clock: bool


def windows_of(messages: RelayedMessages) -> FittedWindows:
    """Fit the windows of at least one message; a `ValueError` for one with `rtt < intermediate`."""
    points = OffsetIntervals(*np.empty((3, len(messages.publish_ns))))
    ordered = _Points.of(messages, points)
    stretches = tuple(find_stretches(points))
    windows = fit_windows(points, stretches)
    return FittedWindows(
        points.time, windows, stretches, ordered.time_origin_ns, ordered.offset_origin_ns, ordered.same_clock
    )


def _segments(
    time: Float64, windows: Windows, stretches: Sequence[tuple[int, int]], fit_points: _Points
) -> tuple[tuple[ClockSegment, ...], tuple[ClockStep, ...]]:
    segments: list[ClockSegment] = []
    steps: list[ClockStep] = []
    last, before = 0, 0  # the last window, and the message after it
    for start, stop in stretches:
        first, after = np.searchsorted(windows.start, (start, stop)).tolist()
        if first == after:  # without a line, each message keeps its own bound
            continue
        if segments:
            edge = time[[before - 1, start]]
            steps.append(_step(edge, windows.last[last], windows.first[first], fit_points.time_origin_ns))
        segments.append(_segment(time[start:stop], windows, slice(first, after), fit_points))
        last, before = after - 1, stop
    return tuple(segments), tuple(steps)


def _segment(time: Float64, windows: Windows, stretch: slice, fit_points: _Points) -> ClockSegment:
    at, offset, bound = windows.time[stretch], windows.offset[stretch], windows.bound[stretch]
    if len(at) > 1:
        drift = (offset[-1] - offset[0]) / (at[-1] - at[0])
        drift_bound = (bound[-1] + bound[0]) / (at[-1] - at[0])
    else:
        gentle, steep = windows.steepness[stretch.start]
        drift, drift_bound = (steep + gentle) / 2, (steep - gentle) / 2
    at_ns = (fit_points.time_origin_ns + np.rint(at).astype(np.int64)).tolist()
    offset_ns = (fit_points.offset_origin_ns + np.rint(offset).astype(np.int64)).tolist()
    bound_ns = np.ceil(bound + 0.5).astype(np.int64).tolist()
    knots = tuple(map(ClockKnot._make, zip(at_ns, offset_ns, bound_ns, strict=True)))
    best = knots[bound_ns.index(min(bound_ns))]
    return ClockSegment(
        start_ns=fit_points.time_origin_ns + int(time[0]),
        end_ns=fit_points.time_origin_ns + int(time[-1]),
        messages=len(time),
        at_ns=best.at_ns,
        offset_ns=best.offset_ns,
        bound_ns=best.bound_ns,
        drift_ppb=float(drift * 1e9),
        drift_bound_ppb=float(drift_bound * 1e9),
        residual_ns=round(float(np.abs(offset - offset[0] - drift * (at - at[0])).max())),
        knots=knots,
    )


def _step(time: Float64, old: Float64, new: Float64, time_origin_ns: int) -> ClockStep:
    drifted = DRIFT * (time[1] - time[0])
    return ClockStep(
        after_ns=time_origin_ns + int(time[0]),
        before_ns=time_origin_ns + int(time[1]),
        size_ns=round(float(new[0] - old[0])),
        bound_ns=int(np.ceil(old[1] + new[1] + drifted + 0.5)),
    )
