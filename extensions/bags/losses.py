"""Missing messages of one topic: what its numbers, stamps and arrival show, each by itself, and what all of them agree on."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from dds_trace.base.units import SECOND_NS, UNIT_NS

from .bounds import DAY_NS, FEW, FEWEST, NEAR, NOTICED_NS, PATTERN, PHASES, WINDOW
from .clocks import of_one_clock
from .holes import Holes
from .periods import (
    Bools,
    Int64,
    Regularity,
    find_grid,
    find_regularity,
    is_explained,
    joined,
    levels_around,
    usual_steps,
)
from .quantiles import indices_of, median, spread, steps_of
from .recorded import NONE

Stretches: TypeAlias = Holes
"""Times over which a clock was set, or no topic has a message; their counts are 0."""

LOST_TYPE = "rosbag2_interfaces/msg/MessagesLostEvent"
COMMANDS = re.compile(
    r"(^|[/_])(action|cmd|cmd_vel|command|goal|joy|keyboard|service_event|teleop)($|[/_])|/(Twist|TwistStamped|Joy|Ackermann\w+)$"
)
"""Topics and types of commands, actions and services: sent while something happens."""


ORIGINAL = "original"


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """What one kind of evidence shows to be missing, within `low` to `high`.

    `name` is `sequence`, `stamps`, `period` (arrival), `recorder`, `tap` or `original` (their own counts).
    """

    name: str
    missing: int
    low: int
    high: int
    holes: Holes = field(default_factory=Holes)
    rhythm: Regularity | None = None

    @staticmethod
    def of(name: str, rhythm: Regularity) -> Reading:
        return Reading(name, rhythm.missing, rhythm.low, rhythm.high, rhythm.holes, rhythm)

    @staticmethod
    def exact(name: str, count: int, holes: Holes, rhythm: Regularity | None = None) -> Reading:
        return Reading(name, count, count, count, holes, rhythm)

    @property
    def rate_hz(self) -> float:
        return self.rhythm.rate_hz if self.rhythm else 0.0

    def contains(self, other: Reading) -> bool:
        return self.low <= other.low and other.high <= self.high


@dataclass(frozen=True, slots=True, eq=False)
class Losses:
    """What is missing of a topic, within `low` to `high` of all readings; None where none of them could show it.

    `evidence` is the name of the reading that `missing` and the holes are of.
    """

    evidence: str = ""
    missing: int | None = None
    low: int | None = None
    high: int | None = None
    holes: Holes = field(default_factory=Holes)
    regularity: Regularity | None = None
    readings: Sequence[Reading] = ()

    def with_gone(self, count: int) -> Losses:
        """Add what a damaged recording counted and its copy lacks; other readings may show the same messages."""
        if not count:
            return self
        missing, low, high = self.missing or 0, self.low or 0, self.high or 0
        evidence = self.evidence if missing > count else ORIGINAL
        readings = [*self.readings, Reading.exact(ORIGINAL, count, Holes())]
        return Losses(
            evidence, max(missing, count), max(low, count), high + count, self.holes, self.regularity, readings
        )


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

    def from_message(self, first: int) -> TopicTimes:
        """Return the messages from one on: those before are a history of messages that were sent earlier."""
        names = ("log_ns", "publish_ns", "stamp_ns", "payload_bytes", "sequence", "publisher", "frame")
        return replace(self, **{name: getattr(self, name)[first:] for name in names}) if first else self

    def readings(self, recording_ns: int, silent: Stretches) -> list[Reading]:
        """Return what each kind of evidence shows, the finest first; `silent` are stretches without a message of any topic."""
        if self.lost is not None and self.counter == "tap":
            rhythm = self._rhythm()
            holes = _filled(rhythm.holes, sum(self.lost)) if rhythm else Holes()
            return [Reading.exact("tap", sum(self.lost), holes, rhythm)]
        readings = [self.by_numbers()]
        if 2 * np.ptp(self.log_ns) >= min(2 * SECOND_NS, recording_ns):  # else it is one burst
            stamps, arrival = self.by_stamps(), self.by_arrival()
            is_faster = stamps and arrival and arrival.rate_hz > (1 + NEAR) * stamps.rate_hz  # of a queue
            readings += [stamps, None if is_faster else arrival]
        counted = [reading for reading in readings if reading and not self._is_in_episodes(reading, silent)]
        if self.lost is not None and (any(self.lost) or not counted):
            counted.insert(0, Reading.exact("recorder", sum(self.lost), Holes()))
        return counted

    def by_numbers(self) -> Reading | None:
        """Count the numbers that a publisher's counter passes over.

        It assumes that a publisher numbers its messages one by one; jumps that repeat are of a thinned topic. A late number fills its hole.
        Without a jump only a publisher's own counter (ROS 1) shows that nothing is missing: others count what they received.
        """
        jumps = []
        for publisher in _few(self.publisher):
            indices = indices_of(self.publisher == publisher)
            sequence = self.sequence[indices]
            restarts = indices_of((steps_of(sequence) < -2 * WINDOW) & (sequence[1:] <= 1)) + 1
            for part in np.split(indices, restarts):
                numbers, first = np.unique(self.sequence[part], return_index=True)
                steps, logged_ns = steps_of(numbers), self.log_ns[part[first]]
                if len(steps) > 1 and 2 * (steps == 1).sum() >= len(steps):
                    waits_ns = steps_of(logged_ns)
                    usual_ns = max(median(np.abs(waits_ns)), 1.0)
                    is_possible = (waits_ns >= 0) & (steps < PATTERN * (waits_ns / usual_ns + 1))
                    is_jump = (steps > 1) & is_possible
                    usual = usual_steps(steps)
                    least = steps - 1 if usual is None else np.maximum(steps // usual - 1, 0)
                    jumps.append(Holes.due(logged_ns[:-1], waits_ns, usual_ns, steps - 1, least).at(is_jump))
        holes = Holes.of(jumps)
        high, low = (max(int(count.sum()) - len(self.left_out_ns), 0) for count in (holes.missing, holes.low))
        if not jumps or not (high or self.is_ros1):
            return None
        return Reading("sequence", high, low, high, holes if high else Holes())

    def by_stamps(self) -> Reading | None:
        """Count the places of a grid without a header stamp (or publish time, if a message has no stamp), for each publisher.

        It assumes a fixed rate. A pattern, a changed rate, and stamps off the grid after a silence (a sleep, a clock that was set) lower
        `low`. Stamps that are log times, and commands, show nothing.
        """
        grid = None
        for keys in (self.publisher, self.frame):
            if grid is None and (parts := _by_key(keys, self._grid)):
                grid = joined(parts)
        grid = grid or self._grid(np.ones(len(self.log_ns), np.bool_))
        return None if grid is None else Reading.of("stamps", grid)

    def _grid(self, selected: Bools) -> Regularity | None:
        times_ns = (self.publish_ns if (self.stamp_ns == NONE).any() else self.stamp_ns)[selected]
        logged_ns = self.log_ns[selected]
        if (times_ns == NONE).any() or 2 * (times_ns == logged_ns).sum() > len(times_ns) or self.is_command:
            return None
        if len(times_ns) > 1 and steps_of(times_ns).min() < -SECOND_NS:  # a clock was set, or a counter ran over
            return None
        order = np.argsort(times_ns, kind="stable")
        stamps_ns, log_ns = times_ns[order], logged_ns[order]
        grid = find_grid(stamps_ns) if of_one_clock(stamps_ns).all() else None
        if grid is None:
            return None
        stamp_period_ns, steps, exact = grid
        steps_ns, log_steps_ns = steps_of(stamps_ns), steps_of(log_ns)
        is_short = steps <= PATTERN
        span_ns, log_span_ns = float(steps_ns[is_short].sum()), float(log_steps_ns[is_short].sum())
        is_same_clock = log_span_ns < 2 * span_ns < 2 * 2 * log_span_ns and abs(median(log_ns - stamps_ns)) < DAY_NS
        period_ns = stamp_period_ns if is_same_clock else stamp_period_ns * log_span_ns / span_ns
        at = indices_of(steps > 1)
        left_out = np.searchsorted(np.sort(self.left_out_ns), stamps_ns)
        repeated = (steps == 0) & (log_steps_ns > period_ns / 2)  # a stamp that was not new yet
        before = np.append(0, np.cumsum(repeated))
        last = np.maximum.accumulate(np.where(steps > 0, np.arange(len(steps)), -1))
        filled = before[at] - before[np.where(at > 0, last[np.maximum(at - 1, 0)] + 1, 0)] + steps_of(left_out)[at]
        lacking = np.maximum(steps[at] - 1 - filled, 0)
        if is_same_clock:
            older, newer = levels_around(log_ns - stamps_ns, at + 1)
            silent_ns = (steps[at] - 1) * stamp_period_ns
            is_set = np.abs(older - newer - silent_ns) < silent_ns / (2 * 2)  # the clock that stamps was set
            few = np.maximum(at - FEWEST // 2, 0)
            is_queue = 2 * (log_ns[at] - log_ns[few]) < stamps_ns[at] - stamps_ns[few]
            lacking[is_set & ~is_queue & (steps[at] > 2 * 2)] = 0
        usual = usual_steps(steps[steps > 0])
        least = lacking
        if usual is not None:
            paces = np.ones(len(steps), np.int64)
            paces[steps > 0] = usual
            least = np.minimum(lacking, np.maximum(steps[at] // np.maximum(paces[at], 1) - 1, 0))
        least = np.where(is_explained(exact, steps, at), 0, least)
        net = max(int((steps[steps_ns > 0] - 1).sum()), 0)  # a stamp that is off by periods is extra elsewhere
        total = min(int(lacking.sum()), net)
        low = max(int(least.sum()) - int(lacking.sum()) + total, 0)
        lacking = lacking if total else lacking * 0
        selected_holes = lacking > 0
        at, lacking, least = at[selected_holes], lacking[selected_holes], least[selected_holes]
        holes = Holes.due(log_ns[at], log_steps_ns[at], period_ns, lacking, least)
        return Regularity(period_ns, 1, spread(steps_ns[steps == 1]), total, low, total, holes=Holes.of([holes]))

    def by_arrival(self) -> Reading | None:
        """Count what the rhythm of the log times lacks.

        It assumes a timer. Commands, and what comes all at once, have none. Where stamps stand still across a hole nothing is missing.
        """
        best = self._rhythm()
        if best is None or best.period_ns * PHASES < NOTICED_NS:
            return None
        best = best.without(self.is_still(best.holes))
        if self.is_command:
            best = best.unsure(np.ones(len(best.holes), np.bool_))
            best = replace(best, low=0)
        after = np.clip(np.searchsorted(self.log_ns, best.holes.start_ns), 1, len(self.log_ns) - 1)
        is_unsure = self.sequence[after] < self.sequence[after - 1]  # the publisher began again
        return Reading.of("period", best.unsure(is_unsure | (2 * best.holes.duration_ns > np.ptp(self.log_ns))))

    def _rhythm(self) -> Regularity | None:
        best = find_regularity(self.log_ns)
        for keys in (self.publisher, self.frame, self.payload_bytes):
            parts = _by_key(keys, lambda selected: find_regularity(self.log_ns[selected]))
            if parts and (best is None or min(part.share for part in parts) > best.share + FEW):
                best = joined(parts)
        return best

    def _is_in_episodes(self, reading: Reading, silent: Stretches) -> bool:
        """Return whether the topic is silent for more than half of its time, more than once: it is sent while something happens."""
        if reading.rhythm is None:
            return False
        holes = reading.holes
        least_ns = FEWEST * reading.rhythm.period_ns
        if not self.is_command:
            holes, least_ns = holes.at(~holes.meet(silent)), max(least_ns, SECOND_NS)
        silences = holes.duration_ns[holes.duration_ns > least_ns]
        if self.is_command:
            return len(silences) > 0
        return len(silences) > 1 and 2 * silences.sum() > self.log_ns[-1] - self.log_ns[0]

    def is_still(self, holes: Holes) -> Bools:
        """Return across which holes stamps go on or back by less than half (what follows is late, or a clock was set), or that messages of another clock fill."""
        at = np.searchsorted(self.log_ns, holes.start_ns)
        at = np.clip(at, 1, max(len(self.log_ns) - 1, 1))
        if len(self.log_ns) < 2 or not len(holes):
            return np.zeros(len(holes), np.bool_)
        before, after = self.stamp_ns[at - 1], self.stamp_ns[at]
        is_stamped = (before != NONE) & (after != NONE)
        unit_ns = resolution_ns(self.stamp_ns) or 0
        step_ns = np.where(is_stamped, after, 0) - np.where(is_stamped, before, 0)
        is_still = (2 * step_ns < holes.duration_ns) & (holes.duration_ns > 2 * unit_ns)
        filled = np.searchsorted(np.sort(self.left_out_ns), np.array([before, after]))
        is_filled = (filled[1] - filled[0] >= holes.missing) & (holes.missing > 0)
        selected: Bools = is_stamped & (is_still | is_filled)
        return selected

    def has_stamps_around(self, holes: Holes) -> Bools:
        is_all = bool((self.stamp_ns != NONE).all())
        selected: Bools = (self.log_ns[0] <= holes.start_ns) & (self.log_ns[-1] >= holes.end_ns) & is_all
        return selected


def resolution_ns(stamp_ns: Int64) -> int | None:
    """Return the unit of stamps if it is a millisecond or, of several stamps each, a second; None for finer ones."""
    steps_ns = np.abs(steps_of(stamp_ns))
    unit_ns = int(np.gcd.reduce(steps_ns)) if len(steps_ns) >= FEWEST else 0
    if unit_ns % SECOND_NS == 0 and unit_ns and 2 * 2 * (steps_ns == 0).sum() > len(steps_ns):
        return SECOND_NS if not (stamp_ns % SECOND_NS).any() else None
    millisecond_ns = UNIT_NS["ms"]
    return millisecond_ns if unit_ns == millisecond_ns and not (stamp_ns % millisecond_ns).any() else None


def quiet_ns(period_ns: float) -> float:
    """Return how long a steady topic is silent at its start or end before this is a hole."""
    return max((2 + 1) * period_ns, SECOND_NS)


def agreed(readings: Sequence[Reading], start_ns: int, end_ns: int, times_ns: Int64) -> Losses:
    """Return the union of the intervals of all readings, `missing` by the finest.

    A coarser interval that contains a finer reading adds nothing. A late start and an early end are holes without a count.
    """
    if not readings:
        return Losses()
    sharp = [
        reading
        for number, reading in enumerate(readings)
        if not any(reading.contains(finer) for finer in readings[:number])
    ]
    low, high = min(reading.low for reading in sharp), max(reading.high for reading in sharp)
    first = sharp[0]
    rhythms = [reading.rhythm for reading in readings if reading.rhythm is not None]
    rhythm = first.rhythm or (rhythms[0] if rhythms else None)
    holes = first.holes
    if not len(holes) and first.missing and rhythm is not None:
        holes = _filled(rhythm.holes, first.missing)
    if rhythm is not None:
        first_ns, last_ns, period_ns = int(times_ns[0]), int(times_ns[-1]), round(rhythm.period_ns)
        ends = []
        if first_ns - start_ns > quiet_ns(period_ns):
            ends.append(Holes.between([start_ns], [first_ns]))
        if end_ns - last_ns > quiet_ns(period_ns):
            ends.append(Holes.between([last_ns + period_ns], [end_ns]))
        elif first.missing and first.rhythm is not None:
            high += (end_ns - last_ns) // max(period_ns, 1) * rhythm.in_pattern
        holes = Holes.of([holes, *ends])
    return Losses(first.name, first.missing, low, high, holes, rhythm, readings)


def _filled(holes: Holes, count: int) -> Holes:
    """Return the holes, the longest first filled with a known number of messages."""
    order = np.argsort(-holes.duration_ns, kind="stable")
    remaining = count - np.append(0, np.cumsum(holes.missing[order]))[:-1]
    missing = np.clip(remaining, 0, holes.missing[order])
    ordered = replace(holes.at(order), missing=missing, low=missing)
    return Holes.of([ordered.at((missing > 0) | (holes.missing[order] == 0))])


def _few(keys: Int64) -> Iterator[int]:
    names = np.unique(keys)
    yield from names[:FEWEST].tolist()


def _by_key(keys: Int64, find: Callable[[Bools], Regularity | None]) -> list[Regularity]:
    names, counts = np.unique(keys, return_counts=True)
    if not 1 < len(names) <= FEWEST or counts.min() < FEWEST:
        return []
    parts = []
    for name in names:
        part = find(keys == name)
        if part is None:
            return []
        parts.append(part)
    return parts
