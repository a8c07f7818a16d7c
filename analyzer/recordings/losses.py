"""Missing messages of one topic, by counters, the recorder's own counts, or the period."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .clocks import of_one_clock
from .periods import Hole, Int64, Regularity, find_regularity, joined, spread

NONE = -(2**63)
LOST_TYPE = "rosbag2_interfaces/msg/MessagesLostEvent"
_MOST_PUBLISHERS = 8
_QUIET = 0.15
"""Jitter of log times, in periods, above which stamps or publish times are looked at, too."""

_LARGEST_STEP = 100_000
_STOPPED_PERIODS, _STOPPED_NS = 3.0, 10**9


@dataclass(frozen=True, slots=True)
class Losses:
    """What is missing of a topic, within `low` to `high`; None where nothing is known.

    `evidence` is `sequence`, `period`, `recorder` (rosbag2's own counts) or empty.
    """

    evidence: str = ""
    missing: int | None = None
    low: int | None = None
    high: int | None = None
    holes: Sequence[Hole] = ()
    regularity: Regularity | None = None
    clock_steps: int = 0


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
    lost: tuple[int, int] | None = None

    def find_losses(self, end_ns: int) -> Losses:
        losses = self._by_period(end_ns)
        by_sequence = self._by_sequence()
        if by_sequence is not None and (by_sequence or self.is_ros1):
            holes = [replace(hole, missing=self._steps_at(hole)) for hole in losses.holes]
            return replace(
                losses, evidence="sequence", missing=by_sequence, low=by_sequence, high=by_sequence, holes=holes
            )
        if losses.missing is None and self.lost is not None:
            count = sum(self.lost)
            return replace(losses, evidence="recorder", missing=count, low=count, high=count)
        return losses

    def _by_sequence(self) -> int | None:
        """Return what a counter passes over; None without a counter."""
        missing, is_counter = 0, False
        for publisher in np.unique(self.publisher)[:_MOST_PUBLISHERS].tolist():
            steps = np.diff(self.sequence[self.publisher == publisher])
            if len(steps) > 1 and (steps == 1).mean() >= 0.5:
                is_counter = True
                missing += int((steps[(steps > 1) & (steps < _LARGEST_STEP)] - 1).sum())
        return missing if is_counter else None

    def _steps_at(self, hole: Hole) -> int:
        at = int(np.searchsorted(self.log_ns, hole.start_ns))
        if not 0 < at < len(self.sequence):
            return 0
        return max(int(self.sequence[at] - self.sequence[at - 1]) - 1, 0)

    def _by_period(self, end_ns: int) -> Losses:
        times_ns, shift_ns = self._steadiest()
        regularity = self._regularity(times_ns)
        if regularity is None:
            return Losses()
        holes = [replace(hole, start_ns=hole.start_ns + shift_ns) for hole in regularity.holes]
        holes_left = holes if shift_ns else [hole for hole in holes if not self._is_clock_step(hole)]
        clock_steps = len(holes) - len(holes_left)
        stepped = sum(hole.missing for hole in holes) - sum(hole.missing for hole in holes_left)
        due_ns = self.log_ns[-1] + regularity.period_ns
        tail = 0
        if end_ns - self.log_ns[-1] > max(_STOPPED_PERIODS * regularity.period_ns, _STOPPED_NS):
            tail = int((end_ns - self.log_ns[-1]) / regularity.period_ns) * regularity.in_pattern
            holes_left.append(Hole(int(due_ns), int(end_ns - due_ns), tail))
        return Losses(
            "period",
            max(regularity.missing - stepped, 0) + tail,
            max(regularity.low - stepped, 0) + max(tail - 1, 0),
            max(regularity.high - stepped, 0) + tail + min(tail, 1),
            holes_left,
            regularity,
            clock_steps,
        )

    def _regularity(self, times_ns: Int64) -> Regularity | None:
        best = find_regularity(times_ns)
        for keys in (self.publisher, self.frame, self.payload_bytes):
            parts = _by_key(times_ns, keys)
            if parts and (best is None or min(part.share for part in parts) > best.share + 0.02):
                best = joined(parts)
        return best

    def _steadiest(self) -> tuple[Int64, int]:
        log = find_regularity(self.log_ns)
        if log is not None and log.jitter_ns < _QUIET * log.period_ns:
            return self.log_ns, 0
        best, jitter, shift_ns = self.log_ns, log.jitter_ns / log.period_ns if log else np.inf, 0
        for times_ns in (self.publish_ns, self.stamp_ns):
            if (times_ns == NONE).any() or not of_one_clock(np.sort(times_ns)).all():
                continue
            regularity = find_regularity(np.sort(times_ns))
            if regularity is not None and regularity.jitter_ns / regularity.period_ns < jitter / 2:
                best, jitter = times_ns, regularity.jitter_ns / regularity.period_ns
                shift_ns = int(np.median(self.log_ns - times_ns)) or 1
        return np.sort(best), shift_ns

    def _is_clock_step(self, hole: Hole) -> bool:
        """Return whether stamps go on across a hole: the recorder's clock was set, and nothing is missing."""
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
