"""Missing messages of one topic: by stamps on a grid, sequence numbers, the rhythm of arrival, or the recorder's own counts."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .clocks import DAY_NS, of_one_clock
from .periods import MOST_STEPS, Hole, Int64, Regularity, find_grid, find_regularity, joined, spread, with_rivals

Stretches: TypeAlias = "Sequence[tuple[int, int]]"
"""Start and end (ns) of times over which the clock was set, or no topic has a message."""

NONE = -(2**63)
LOST_TYPE = "rosbag2_interfaces/msg/MessagesLostEvent"
_MOST_PUBLISHERS = 8
_LEAST_RESTART, _MOST_FASTER = 64, 16
"""Least fall of a counter that starts again, and how much faster it may count in a hole."""

_LARGEST_STEP = 100_000
_STOPPED_PERIODS, _STOPPED_NS, _AROUND = 3.0, 10**9, 200
_SILENT_PERIODS, _SILENT_COMMAND_PERIODS = 10, 5
_MOST_SILENT = 0.5
"""Share of its time that a topic with a rhythm may be silent."""

_SAME_RATE = 0.01
COMMANDS = re.compile(
    r"(^|[/_])(action|cmd|cmd_vel|command|goal|joy|keyboard|service_event|teleop)($|[/_])|/(Twist|TwistStamped|Joy|Ackermann\w+)$"
)
"""Topics and types of commands, actions and services: sent while something happens."""


@dataclass(frozen=True, slots=True)
class Losses:
    """What is missing of a topic, within `low` to `high`; None where nothing is known.

    `evidence` is `stamps`, `sequence`, `period`, `recorder` or `tap` (their own counts) or empty.
    """

    evidence: str = ""
    missing: int | None = None
    low: int | None = None
    high: int | None = None
    holes: Sequence[Hole] = ()
    regularity: Regularity | None = None


@dataclass(slots=True)
class TopicTimes:
    """Messages of one topic by log time, as arrays of one length; `NONE` for a value that a message lacks."""

    log_ns: Int64
    publish_ns: Int64
    stamp_ns: Int64
    payload_bytes: Int64
    sequence: Int64
    publisher: Int64
    frame: Int64
    is_ros1: bool = False
    is_command: bool = False
    lost: tuple[int, int] | None = None
    """What `counter`, `tap` or `recorder`, lost on the way to it, and inside."""

    counter: str = ""
    left_out_ns: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    """Such stamps of messages that were logged by another clock."""

    def find_losses(self, start_ns: int, end_ns: int, set_over: Stretches = (), silent: Stretches = ()) -> Losses:
        losses, jumps = self._by_rhythm(start_ns, end_ns, set_over, silent), self._jumps()
        if self.lost is not None and self.counter == "tap":
            return _by_counts(losses, sum(self.lost), self.counter)
        if jumps is not None:
            count = max(int(jumps[2].sum()) - len(self.left_out_ns), 0)
            has_restarted = ((np.diff(self.sequence) < -_LEAST_RESTART) & (self.sequence[1:] <= 1)).any()
            is_least = losses.evidence == "stamps" and count <= (losses.missing or 0) and not has_restarted
            if self.is_ros1 or (count and not is_least):
                from_ns, to_ns = jumps[0], jumps[0] + jumps[1]
                within = [(from_ns < h.start_ns + h.duration_ns) & (to_ns > h.start_ns) for h in losses.holes]
                holes = [replace(h, missing=int(jumps[2][i].sum())) for h, i in zip(losses.holes, within, strict=True)]
                holes = holes or [Hole(*jump) for jump in jumps.T.tolist()]
                return replace(losses, evidence="sequence", missing=count, low=count, high=count, holes=holes)
        if losses.missing is None and self.lost is not None:
            return _by_counts(losses, sum(self.lost), self.counter)
        return losses

    def _jumps(self) -> Int64 | None:
        """Return rows of starts, durations (ns) and numbers of messages that counters pass over; None without a counter.

        A late number fills its hole; one that came before the previous one is of another counter on the channel.
        """
        jumps = []
        for publisher in np.unique(self.publisher)[:_MOST_PUBLISHERS].tolist():
            indices = np.flatnonzero(self.publisher == publisher)
            sequence = self.sequence[indices]
            restarts = np.flatnonzero((np.diff(sequence) < -_LEAST_RESTART) & (sequence[1:] <= 1)) + 1
            for part in np.split(indices, restarts):
                numbers, first = np.unique(self.sequence[part], return_index=True)
                steps, waits_ns = np.diff(numbers), np.diff(self.log_ns[part[first]])
                if len(steps) > 1 and (steps == 1).mean() >= 0.5:
                    usual_ns = max(float(np.median(np.abs(waits_ns))), 1.0)
                    is_possible = (waits_ns >= 0) & (steps < _MOST_FASTER * (waits_ns / usual_ns + 1))
                    is_jump = (steps > 1) & (steps < _LARGEST_STEP) & is_possible
                    jumps.append(np.array([self.log_ns[part[first]][:-1], waits_ns, steps - 1])[:, is_jump])
        if not jumps:
            return None
        ordered = np.concatenate(jumps, axis=1)
        return ordered[:, np.argsort(ordered[0], kind="stable")]

    def _by_rhythm(self, start_ns: int, end_ns: int, set_over: Stretches, silent: Stretches) -> Losses:
        """Count by stamps on a grid, else by the rhythm of arrival; a late start and an early end are holes without a count."""
        grid = self._by_grid()
        regularity = self._regularity(self.log_ns) if grid is None or not grid.missing else None
        if regularity is not None:
            regularity = regularity.without(
                lambda hole: self.is_still(hole.start_ns, hole.duration_ns) or any(hole.overlaps(*s) for s in set_over)
            )
        evidence = "period"
        if grid is not None and (
            regularity is None
            or (regularity.low, regularity.high) != (grid.missing, grid.missing)
            or abs(regularity.rate_hz / grid.rate_hz - 1) > _SAME_RATE
        ):
            regularity, evidence = grid, "stamps"
        first_ns, last_ns = int(self.log_ns[0]), int(self.log_ns[-1])
        is_burst = last_ns - first_ns < min(_STOPPED_NS, (end_ns - start_ns) / 2)
        if regularity is None or is_burst or self._is_silent(regularity, silent):
            return Losses()
        high, period_ns = regularity.high, regularity.period_ns
        holes = regularity.holes[:]
        quiet_ns = max(_STOPPED_PERIODS * period_ns, _STOPPED_NS)
        if first_ns - start_ns > quiet_ns:
            holes.insert(0, Hole(start_ns, first_ns - start_ns, 0))
        if end_ns - last_ns > quiet_ns:
            holes.append(Hole(round(last_ns + period_ns), round(end_ns - last_ns - period_ns), 0))
        elif regularity.missing:
            high += int((end_ns - last_ns) / period_ns) * regularity.in_pattern
        return Losses(evidence, regularity.missing, regularity.low, high, holes, regularity)

    def _is_silent(self, regularity: Regularity, silent: Stretches) -> bool:
        period_ns = regularity.period_ns
        least_ns = (
            _SILENT_COMMAND_PERIODS * period_ns if self.is_command else max(_SILENT_PERIODS * period_ns, _STOPPED_NS)
        )
        own = [hole for hole in regularity.holes if self.is_command or not any(hole.overlaps(*s) for s in silent)]
        silent_ns = sum(hole.duration_ns for hole in own if hole.duration_ns > least_ns)
        return silent_ns > (0 if self.is_command else _MOST_SILENT * float(self.log_ns[-1] - self.log_ns[0]))

    def _by_grid(self) -> Regularity | None:
        """Return the grid of the header stamps, or of the publish times if a message has no stamp; of several publishers, of each."""
        for keys in (self.publisher, self.frame):
            if parts := _by_key(keys, self._grid):
                return joined(parts)
        return self._grid(np.ones(len(self.log_ns), np.bool_))

    def _grid(self, selected: NDArray[np.bool_]) -> Regularity | None:
        times_ns = (self.publish_ns if (self.stamp_ns == NONE).any() else self.stamp_ns)[selected]
        logged_ns = self.log_ns[selected]
        if (times_ns == NONE).any() or (times_ns == logged_ns).mean() > 0.5 or self.is_command:
            return None
        if len(times_ns) > 1 and np.diff(times_ns).min() < -_STOPPED_NS:  # a clock was set, or a counter ran over
            return None
        order = np.argsort(times_ns, kind="stable")
        stamps_ns, log_ns = times_ns[order], logged_ns[order]
        grid = find_grid(stamps_ns) if of_one_clock(stamps_ns).all() else None
        if grid is None:
            return None
        (stamp_period_ns, steps), steps_ns = grid, np.diff(stamps_ns)
        is_short = steps <= MOST_STEPS
        span_ns, log_span_ns = (float(part[is_short].sum()) for part in (steps_ns, np.diff(log_ns)))
        is_same_clock = (
            log_span_ns < 2 * span_ns < 4 * log_span_ns and abs(float(np.median(log_ns - stamps_ns))) < DAY_NS
        )
        period_ns = stamp_period_ns if is_same_clock else stamp_period_ns * log_span_ns / span_ns
        is_later = steps_ns > 0  # the same stamp again fills no hole
        total, holes = max(int((steps[is_later] - 1).sum()), 0), []
        for at in np.flatnonzero(steps > 1).tolist() if total else ():
            lacking = int(steps[at]) - 1
            left_out = ((self.left_out_ns > stamps_ns[at]) & (self.left_out_ns < stamps_ns[at + 1])).sum()
            missing = max(lacking - int(left_out), 0)
            silent_ns = lacking * stamp_period_ns
            if is_same_clock and lacking > _STOPPED_PERIODS:
                ages = (log_ns - stamps_ns)[max(at + 1 - _AROUND, 0) : at + 1 + _AROUND]
                before = min(at + 1, _AROUND)
                younger_ns = float(np.median(ages[:before]) - np.median(ages[before:]))
                missing *= abs(younger_ns - silent_ns) > silent_ns / 4  # else the clock that stamps them was set
            total -= lacking - missing
            if missing:
                duration_ns = max(float(log_ns[at + 1] - log_ns[at]) - period_ns, missing * period_ns)
                holes.append(Hole(round(log_ns[at] + period_ns), round(duration_ns), missing))
        missing, holes = max(total, 0), sorted(holes, key=lambda hole: hole.start_ns)
        regularity = Regularity(period_ns, 1, spread(steps_ns[steps == 1]), missing, missing, missing, holes=holes)
        return with_rivals(regularity, steps[is_later]) if missing else regularity

    def _regularity(self, times_ns: Int64) -> Regularity | None:
        best = find_regularity(times_ns)
        for keys in (self.publisher, self.frame, self.payload_bytes):
            parts = _by_key(keys, lambda selected: find_regularity(times_ns[selected]))
            if parts and (best is None or min(part.share for part in parts) > best.share + 0.02):
                best = joined(parts)
        return best

    def has_stamps_around(self, start_ns: int, end_ns: int) -> bool:
        return bool(self.log_ns[0] <= start_ns and self.log_ns[-1] >= end_ns and (self.stamp_ns != NONE).all())

    def is_still(self, start_ns: int, duration_ns: int) -> bool:
        """Return whether stamps go on or back across a hole: what follows is late, or a clock was set, and nothing is missing."""
        at = int(np.searchsorted(self.log_ns, start_ns))
        if not 0 < at < len(self.stamp_ns) or NONE in (self.stamp_ns[at], self.stamp_ns[at - 1]):
            return False
        return duration_ns > 10**9 and int(self.stamp_ns[at] - self.stamp_ns[at - 1]) < duration_ns // 4


def _by_counts(losses: Losses, count: int, evidence: str) -> Losses:
    remaining, holes = count, list[Hole]()
    for hole in sorted(losses.holes, key=lambda hole: -hole.duration_ns):
        missing = min(hole.missing, remaining)
        remaining -= missing
        holes += [replace(hole, missing=missing)] * bool(missing or not hole.missing)
    holes.sort(key=lambda hole: hole.start_ns)
    return replace(losses, evidence=evidence, missing=count, low=count, high=count, holes=holes)


def _by_key(keys: Int64, find: Callable[[NDArray[np.bool_]], Regularity | None]) -> list[Regularity]:
    names, counts = np.unique(keys, return_counts=True)
    if not 1 < len(names) <= _MOST_PUBLISHERS or counts.min() < 8:
        return []
    parts = [find(keys == name) for name in names]
    return [part for part in parts if part is not None] if all(parts) else []
