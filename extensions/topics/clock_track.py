"""One device's clock against another's at any instant: what the windows of a fit leave open, between messages and near them.

Within a window the upper end of all lines is convex and the lower one concave, so the chords between its first, tightest and
last instant enclose them. Elsewhere a clock keeps its rate within `WANDER`, for `REACH_NS` at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dds_trace.analyzer.clocks.fit import ClockOffsets, RelayedMessages, windows_of
from dds_trace.analyzer.clocks.lines import Float64, Int64
from dds_trace.analyzer.clocks.windows import WINDOW_NS

REACH_NS = 600_000_000_000
"""Farthest from a message that a clock is known."""

WANDER = 1e-6
"""Largest change of rate without messages: crystals change by below 1 ppm in minutes."""

UNKNOWN_NS = 1 << 62
"""Bound of an offset that is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """Ends of the offset at ascending instants of one stretch; smallest and largest slope in the first and the last window."""

    time: Float64
    low: Float64
    high: Float64
    first_slopes: Float64
    last_slopes: Float64

    def ends_at(self, time: Float64) -> tuple[Float64, Float64]:
        low, high = np.interp(time, self.time, self.low), np.interp(time, self.time, self.high)
        after = np.clip(np.searchsorted(self.time, time), 1, len(self.time) - 1)
        left, right = self.time[after - 1], self.time[after]
        is_gap = (right - left > WINDOW_NS) & (time > left) & (time < right)
        slack = np.where(is_gap, WANDER * np.minimum(time - left, right - time), 0.0)
        before, beyond = np.maximum(self.time[0] - time, 0), np.maximum(time - self.time[-1], 0)
        slack += WANDER * (before + beyond)
        low += -before * self.first_slopes[1] + beyond * self.last_slopes[0] - slack
        high += -before * self.first_slopes[0] + beyond * self.last_slopes[1] + slack
        return low, high


@dataclass(frozen=True, slots=True, eq=False)
class ClockTrack:
    """The relay's clock minus the ping's; `same_clock` if they are one."""

    pieces: tuple[_Piece, ...]
    time_origin_ns: int
    offset_origin_ns: int
    same_clock: bool

    def at(self, ping_ns: Int64) -> ClockOffsets:
        """Return the offset at instants of the ping's clock, bound by `UNKNOWN_NS` far from messages and around steps."""
        offset_ns = np.zeros(len(ping_ns), np.int64)
        if self.same_clock:
            return ClockOffsets(offset_ns, np.zeros(len(ping_ns), np.int64))
        bound_ns = np.full(len(ping_ns), UNKNOWN_NS, np.int64)
        time = (ping_ns - self.time_origin_ns).astype(np.float64)
        for number, piece in enumerate(self.pieces):
            begin = piece.time[0] - (REACH_NS if number == 0 else 0)
            end = piece.time[-1] + (REACH_NS if number == len(self.pieces) - 1 else 0)
            is_inside = (time >= begin) & (time <= end)
            low, high = piece.ends_at(time[is_inside])
            offset_ns[is_inside] = self.offset_origin_ns + np.rint((low + high) / 2).astype(np.int64)
            bound_ns[is_inside] = np.ceil((high - low) / 2 + 0.5).astype(np.int64)
        return ClockOffsets(offset_ns, bound_ns)

    def at_relay(self, relay_ns: Int64) -> ClockOffsets:
        ping_ns = relay_ns - self.offset_origin_ns
        for _ in range(3):  # clocks part by 0.1 % at most, so each turn is a thousand times closer
            ping_ns = relay_ns - self.at(ping_ns).offset_ns
        return self.at(ping_ns)


def track_clock(messages: RelayedMessages) -> ClockTrack:
    """Fit the clocks of two devices by at least one message; a `ValueError` for one with `rtt < intermediate`."""
    fitted = windows_of(messages)
    windows, pieces = fitted.windows, []
    for start, stop in fitted.stretches:
        first, after = np.searchsorted(windows.start, (start, stop)).tolist()
        if first == after:
            continue
        span = slice(first, after)
        time = np.stack(
            [fitted.time[windows.start[span]], windows.time[span], fitted.time[windows.stop[span] - 1]], axis=1
        )
        middle = np.stack([windows.first[span, 0], windows.offset[span], windows.last[span, 0]], axis=1)
        half = np.stack([windows.first[span, 1], windows.bound[span], windows.last[span, 1]], axis=1)
        pieces.append(
            _Piece(
                time.ravel(),
                (middle - half).ravel(),
                (middle + half).ravel(),
                windows.steepness[first],
                windows.steepness[after - 1],
            )
        )
    return ClockTrack(tuple(pieces), fitted.time_origin_ns, fitted.offset_origin_ns, fitted.same_clock)
