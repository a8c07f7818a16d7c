"""Missing messages of one topic: by stamps on a grid, sequence numbers, the rhythm of arrival, or the recorder's own counts."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .clocks import DAY_NS, of_one_clock
from .periods import Hole, Int64, Regularity, find_grid, find_regularity, joined, spread

NONE = -(2**63)
LOST_TYPE = "rosbag2_interfaces/msg/MessagesLostEvent"
_MOST_PUBLISHERS = 8
_LARGEST_STEP = 100_000
_STOPPED_PERIODS, _STOPPED_NS = 3.0, 10**9
_SILENT_PERIODS, _SILENT_COMMAND_PERIODS = 10, 5
_MOST_SILENT = 0.5
"""Share of its time that a topic with a rhythm may be silent."""

_SAME_RATE = 0.01
_COMMANDS = re.compile(
    r"(^|[/_])(cmd|cmd_vel|command|goal|joy|keyboard|teleop)($|[/_])|/(Twist|TwistStamped|Joy|Ackermann\w+)$"
)
"""Topics and types by which a person or a planner commands: sent while something happens."""


@dataclass(frozen=True, slots=True)
class Losses:
    """What is missing of a topic, within `low` to `high`; None where nothing is known.

    `evidence` is `stamps`, `sequence`, `period`, `recorder` (rosbag2's own counts) or empty.
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
    left_out_ns: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    """Such stamps of messages that were logged by another clock."""

    def find_losses(self, start_ns: int, end_ns: int) -> Losses:
        losses, jumps = self._by_rhythm(start_ns, end_ns), self._jumps()
        by_sequence = max(sum(int(jump[2].sum()) for jump in jumps) - len(self.left_out_ns), 0) if jumps else None
        counts = by_sequence if self.is_ros1 else by_sequence or None
        if counts is not None and (self.is_ros1 or losses.evidence != "stamps" or counts > (losses.missing or 0)):
            holes = [replace(hole, missing=self._steps_at(hole)) for hole in losses.holes]
            holes = holes or [Hole(*jump) for jump in sorted(np.concatenate(jumps, axis=1).T.tolist())]
            return replace(losses, evidence="sequence", missing=counts, low=counts, high=counts, holes=holes)
        if losses.missing is None and self.lost is not None:
            count = sum(self.lost)
            return replace(losses, evidence="recorder", missing=count, low=count, high=count)
        return losses

    def _jumps(self) -> list[Int64]:
        """Return, for each publisher that counts, what it passes over: rows of starts, durations (ns) and numbers of messages."""
        jumps = []
        for publisher in np.unique(self.publisher)[:_MOST_PUBLISHERS].tolist():
            is_own = self.publisher == publisher
            log_ns, steps = self.log_ns[is_own], np.diff(self.sequence[is_own])
            if len(steps) > 1 and (steps == 1).mean() >= 0.5:
                is_jump = (steps > 1) & (steps < _LARGEST_STEP)
                jumps.append(np.array([log_ns[:-1], np.diff(log_ns), steps - 1])[:, is_jump])
        return jumps

    def _steps_at(self, hole: Hole) -> int:
        at = int(np.searchsorted(self.log_ns, hole.start_ns))
        if not 0 < at < len(self.sequence):
            return 0
        return max(int(self.sequence[at] - self.sequence[at - 1]) - 1, 0)

    def _by_rhythm(self, start_ns: int, end_ns: int) -> Losses:
        """Count by stamps on a grid, else by the rhythm of arrival; a late start and an early end are holes without a count."""
        grid = self._by_grid()
        regularity = self._by_arrival() if grid is None or not grid.missing else None
        evidence = "period"
        if grid is not None and (
            regularity is None
            or (regularity.low, regularity.high) != (grid.missing, grid.missing)
            or abs(regularity.rate_hz / grid.rate_hz - 1) > _SAME_RATE
        ):
            regularity, evidence = grid, "stamps"
        first_ns, last_ns = int(self.log_ns[0]), int(self.log_ns[-1])
        is_burst = last_ns - first_ns < min(_STOPPED_NS, (end_ns - start_ns) / 2)
        if regularity is None or is_burst or self._is_silent(regularity):
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

    def _is_silent(self, regularity: Regularity) -> bool:
        """Return whether the topic has a rhythm only while something happens."""
        period_ns = regularity.period_ns
        least_ns = (
            _SILENT_COMMAND_PERIODS * period_ns if self.is_command else max(_SILENT_PERIODS * period_ns, _STOPPED_NS)
        )
        silent_ns = sum(hole.duration_ns for hole in regularity.holes if hole.duration_ns > least_ns)
        return silent_ns > (0 if self.is_command else _MOST_SILENT * float(self.log_ns[-1] - self.log_ns[0]))

    def _by_grid(self) -> Regularity | None:
        """Return the grid of the header stamps, or of the publish times if a message has no stamp."""
        times_ns = self.publish_ns if (self.stamp_ns == NONE).any() else self.stamp_ns
        if (times_ns == NONE).any() or (times_ns == self.log_ns).mean() > 0.5 or self.is_command:
            return None
        if len(times_ns) > 1 and np.diff(times_ns).min() < -_STOPPED_NS:  # a clock was set, or a counter ran over
            return None
        order = np.argsort(times_ns, kind="stable")
        stamps_ns, log_ns = times_ns[order], self.log_ns[order]
        grid = find_grid(stamps_ns) if of_one_clock(stamps_ns).all() else None
        if grid is None:
            return None
        steps = float(stamps_ns[-1] - stamps_ns[0]) / grid.period_ns
        is_same_clock = abs(float(np.median(log_ns - stamps_ns))) < DAY_NS
        period_ns = grid.period_ns if is_same_clock else float(log_ns[-1] - log_ns[0]) / steps
        holes, jumped = [], 0
        for hole in grid.holes:
            at = int(np.searchsorted(stamps_ns, hole.start_ns))
            left_out = ((self.left_out_ns > stamps_ns[at - 1]) & (self.left_out_ns < stamps_ns[at])).sum()
            missing = max(hole.missing - int(left_out), 0)
            jumped += hole.missing - missing
            if not missing:
                continue
            if is_same_clock and hole.duration_ns > 10**9 and log_ns[at] < stamps_ns[at] - hole.duration_ns // 2:
                jumped += missing  # the clock that stamps them was set
                continue
            duration_ns = max(float(log_ns[at] - log_ns[at - 1]) - period_ns, missing * period_ns)
            holes.append(Hole(round(log_ns[at - 1] + period_ns), round(duration_ns), missing))
        missing, holes = max(grid.missing - jumped, 0), sorted(holes, key=lambda hole: hole.start_ns)
        return replace(grid, period_ns=period_ns, missing=missing, low=missing, high=missing, holes=holes)

    def _by_arrival(self) -> Regularity | None:
        regularity = self._regularity(self.log_ns)
        if regularity is None:
            return None
        holes = regularity.holes
        holes_left = [hole for hole in holes if not self._is_late(hole)]
        late = sum(hole.missing for hole in holes) - sum(hole.missing for hole in holes_left)
        low, missing, high = (max(count - late, 0) for count in (regularity.low, regularity.missing, regularity.high))
        return replace(regularity, missing=missing, low=low, high=high, holes=holes_left)

    def _regularity(self, times_ns: Int64) -> Regularity | None:
        best = find_regularity(times_ns)
        for keys in (self.publisher, self.frame, self.payload_bytes):
            parts = _by_key(times_ns, keys)
            if parts and (best is None or min(part.share for part in parts) > best.share + 0.02):
                best = joined(parts)
        return best

    def _is_late(self, hole: Hole) -> bool:
        """Return whether stamps go on across a hole: what follows is late, or a clock was set, and nothing is missing."""
        at = int(np.searchsorted(self.log_ns, hole.start_ns))
        if not 0 < at < len(self.stamp_ns) or NONE in (self.stamp_ns[at], self.stamp_ns[at - 1]):
            return False
        return hole.duration_ns > 10**9 and 0 <= int(self.stamp_ns[at] - self.stamp_ns[at - 1]) < hole.duration_ns // 4


def _by_key(times_ns: Int64, keys: Int64) -> list[Regularity]:
    """Return the regularity of each publisher; nothing unless several are there and all regular."""
    names, counts = np.unique(keys, return_counts=True)
    if not 1 < len(names) <= _MOST_PUBLISHERS or counts.min() < 8:
        return []
    parts = [find_regularity(times_ns[keys == name]) for name in names]
    return [part for part in parts if part is not None] if all(parts) else []


def is_command(topic: str, message_type: str) -> bool:
    return _COMMANDS.search(topic) is not None or _COMMANDS.search(message_type) is not None


def lost_by_recorder(data: bytes) -> Iterator[tuple[str, int, int]]:
    order = "<" if data[1:2] == b"\1" else ">"
    body, at = data[4:], 0

    def text() -> str:
        nonlocal at
        at = -(-at // 4) * 4
        (size,) = struct.unpack_from(f"{order}I", body, at)
        at += 4 + size
        return body[at - size : at].rstrip(b"\0").decode(errors="replace")

    try:
        text()
        at = -(-at // 4) * 4
        (count,) = struct.unpack_from(f"{order}I", body, at)
        at += 4
        for _ in range(min(count, len(body) // 21)):
            topic = text()
            at = -(-at // 8) * 8
            transport, recorder = struct.unpack_from(f"{order}QQ", body, at)
            at += 16
            yield topic, transport, recorder
    except struct.error:
        return


def arrival_jitter_ns(log_ns: Int64, regularity: Regularity | None) -> float | None:
    """Return the robust deviation of log intervals; None of a single message."""
    lag = regularity.in_pattern if regularity else 1
    if len(log_ns) <= lag:
        return None
    return spread(log_ns[lag:] - log_ns[:-lag])
