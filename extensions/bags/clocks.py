"""The clocks of a recording: which one its times are of, where one was set or ran over, and which topics became late."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dds_trace.base.units import clock_words, counted, format_duration

from .periods import Int64

DAY_NS = 86_400 * 10**9
_APART_NS, _LONGEST_UP_NS = 30 * DAY_NS, 365 * DAY_NS
SIMULATED_BEFORE_NS = 10**9 * 10**9  # September 2001: no recorder of today
_JUMP_NS = 10**9
_COUNTERS = {"ns": 1, "us": 1_000, "ms": 1_000_000}
_LEAST_STEP_NS, _STEP_SPREADS = 200_000_000, 6.0
_FEWEST = 8
_MOST_STEPS = 5
_LEAST_BACK_NS = 100_000_000
_WHY_BACK = "a clock that was set back, a simulation that was reset, or joined files?"
_SAME_STEP, _SAME_TIME_NS = 0.2, 2 * 10**9
_AHEAD_NS = {37 * 10**9: "TAI", 18 * 10**9: "GPS time"}
_AHEAD_WITHIN_NS = 600_000_000
_UNITS = {
    1e-6: ("slowly", "milliseconds", "nanoseconds"),
    1e-3: ("slowly", "microseconds", "nanoseconds"),
    1e3: ("fast", "nanoseconds", "microseconds"),
}
_SAME_SPEED, _LEAST_OTHER_SPEED = 0.1, 0.03
_GROWTH, _LEAST_GROWTH_NS, _AGE_PARTS = 3.0, 100_000_000, 20
_FEWEST_RISING, _LEAST_FIT = 5, 0.95


def of_one_clock(log_ns: Int64) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which ascending log times are of the recording's clock, not at time 0 of a simulation."""
    gaps = np.flatnonzero(np.diff(log_ns) > _APART_NS)
    edges = np.concatenate([[0], gaps + 1, [len(log_ns)]])
    largest = int(np.argmax(np.diff(edges)))
    selected = np.zeros(len(log_ns), bool)
    selected[edges[largest] : edges[largest + 1]] = True
    return selected


def apart(time_ns: float) -> str:
    days = time_ns / DAY_NS
    return f"{days / 365.25:.0f} years" if days > 365.25 else f"{days:.0f} days"


def set_back(backwards_ns: Mapping[str, int]) -> Iterator[str]:
    names = sorted((name for name in backwards_ns if backwards_ns[name]), key=lambda name: -backwards_ns[name])
    if names:
        are = "is" if len(names) == 1 else "are"
        size = format_duration(backwards_ns[names[0]])
        yield f"{_and_more(names)} {are} not stored in order of time, up to {size} back: {_WHY_BACK}"


def reset_note(back_ns: int, at_ns: int, stamped: int) -> str:
    size, at = format_duration(back_ns), clock_words(at_ns / 1e9)
    if stamped:
        return f"the recorder's clock was set back by {size} at {at}: the stamps of {counted(stamped, 'topic')} go on without a step"
    return f"the times of all topics begin again at {at}, {size} back: {_WHY_BACK}"


def find_resets(log_ns: Int64) -> list[int]:
    """Return the indices of stored log times that begin again: late messages leap to the others, and pieces in disorder fit together."""
    before_ns = np.minimum(log_ns[1:-2], log_ns[:-3])
    resets: list[int] = (np.flatnonzero(np.maximum(log_ns[2:-1], log_ns[3:]) < before_ns - _LEAST_BACK_NS) + 2).tolist()
    if len(resets) > _MOST_STEPS:
        return []
    for at in resets:
        back_ns = int(log_ns[at - 1] - log_ns[at])
        is_beyond = log_ns[at:] >= log_ns[at - 1]
        again = at + int(np.argmax(is_beyond)) if is_beyond.any() else at
        apart_ns = int(log_ns[:at].min() - log_ns[at:].max())
        if log_ns[again] - log_ns[again - 1] > back_ns / 2 or 0 <= apart_ns < _SAME_TIME_NS:
            return []
    return resets


def backwards_ns(log_ns: Int64) -> int:
    step_ns = -int(np.diff(log_ns, prepend=log_ns[:1]).min())
    return step_ns if step_ns > _JUMP_NS else 0


class Stamps(NamedTuple):
    log_ns: Int64
    stamp_ns: Int64

    @property
    def age_ns(self) -> Int64:
        return self.log_ns - self.stamp_ns

    @property
    def speed(self) -> float:
        return float(self.stamp_ns[-1] - self.stamp_ns[0]) / max(float(self.log_ns[-1] - self.log_ns[0]), 1.0)


class _Step(NamedTuple):
    """The age of a topic's messages changes for good with the message of `log_ns`."""

    topic: str
    log_ns: int
    size_ns: int
    stamp_step_ns: int
    age_ns: int


def stamp_notes(
    topics: Mapping[str, Stamps], unstamped: Sequence[Int64], start_ns: int
) -> tuple[list[str], list[tuple[int, int]]]:
    """Return what changes in the ages of topics, and stretches over which the recorder's clock was set: every topic moves with it."""
    steps: list[_Step] = []
    notes: list[str] = []
    other_clocks: dict[str, float] = {}
    for name, stamps in topics.items():
        special = next(_special_notes(name, stamps, start_ns), "")
        age_ns = abs(float(np.median(stamps.age_ns)))
        if special:
            notes.append(special)
            continue
        if age_ns > DAY_NS:
            other_clocks[name] = age_ns
        clock_steps = _steps(name, stamps)
        if len(clock_steps) <= _MOST_STEPS:
            steps += clock_steps
        since_ns = None if clock_steps else growth_since_ns(stamps.log_ns, stamps.stamp_ns)
        if since_ns is not None:
            first_age, last_age = map(format_duration, age_course(stamps.age_ns))
            when = (
                f"since {clock_words((since_ns - start_ns) / 1e9)}" if since_ns > stamps.log_ns[0] else "all the time"
            )
            notes.append(
                f"the age of {name} grows from {first_age} to {last_age}, {when}: a queue that fills, or a clock that runs at another speed"
            )
    set_over: list[tuple[int, int]] = []
    notes += _other_clocks(other_clocks, topics)
    while steps:
        same = [step for step in steps if _is_same(step, steps[0])]
        steps = [step for step in steps if step not in same]
        step_notes, is_of_recorder = _step_notes(same, topics, unstamped, start_ns)
        notes += step_notes
        set_over += [(same[0].log_ns - same[0].size_ns, same[0].log_ns)] * is_of_recorder
    return notes, set_over


def _other_clocks(ages_ns: Mapping[str, float], topics: Mapping[str, Stamps]) -> Iterator[str]:
    speeds = {name: topics[name].speed for name in ages_ns if len(topics[name].log_ns) >= _FEWEST}
    simulated = [name for name, speed in speeds.items() if speed > 0 and abs(speed - 1) > _LEAST_OTHER_SPEED]
    others = sorted(ages_ns.keys() - {*simulated}, key=lambda name: -ages_ns[name])
    if simulated:
        speed = f"{float(np.median([speeds[name] for name in simulated])):.3g}"
        yield f"stamps of {_and_more(simulated)} advance {speed} s a second: a simulation that runs at {speed} of real time?"
    if others:
        away = apart(ages_ns[others[0]])
        yield f"stamps of {_and_more(others)} are {away} from the log times: of another clock (a simulation?), not an age"


def _and_more(names: Sequence[str]) -> str:
    return names[0] + (f" and {counted(len(names) - 1, 'more topic')}" if len(names) > 1 else "")


def _step_notes(
    steps: Sequence[_Step], topics: Mapping[str, Stamps], unstamped: Sequence[Int64], start_ns: int
) -> tuple[list[str], bool]:
    first, moved = steps[0], sorted({step.topic for step in steps})
    is_of_stamps = first.stamp_step_ns < 0 or (first.size_ns < 0 and first.age_ns < -_LEAST_STEP_NS)
    late_ns = 0 if is_of_stamps else max(first.size_ns, 0)
    at, size = clock_words((first.log_ns - late_ns - start_ns) / 1e9), format_duration(abs(first.size_ns))
    if is_of_stamps:
        like = next((name for name in topics if name not in moved and _has_its_age(topics[name], first)), "")
        who = f"like {like}: of another publisher, a replay?" if like else "the clock that stamps them was set"
        return [
            f"stamps of {name} jump 1 time against the log times, by {size} at {at}: {who}" for name in moved
        ], False
    others = [stamps.log_ns for name, stamps in topics.items() if name not in moved]
    witnesses = sum(_goes_on(log_ns, first) for log_ns in (*others, *unstamped))
    direction, became = ("forward", "later") if first.size_ns > 0 else ("back", "earlier")
    clock = f"the recorder's clock was set {direction} by {size} at {at}"
    if not witnesses and len(moved) > 1:
        return [f"{clock}: the stamps of all {len(moved)} topics go on without a step"], True
    unsure = "" if witnesses else f", or {clock}: no other topic shows which"
    return [f"{name} became {size} {became} at {at}{unsure}" for name in moved], False


def _is_same(step: _Step, other: _Step) -> bool:
    apart_ns = abs(step.log_ns - other.log_ns)
    return apart_ns < abs(other.size_ns) / 2 + _SAME_TIME_NS and abs(step.size_ns - other.size_ns) < _SAME_STEP * abs(
        other.size_ns
    )


def _has_its_age(stamps: Stamps, step: _Step) -> bool:
    ages_ns = stamps.age_ns[stamps.log_ns < step.log_ns + _SAME_TIME_NS]
    return len(ages_ns) > 0 and float((np.abs(ages_ns - step.age_ns) < _SAME_STEP * abs(step.size_ns)).mean()) > 0.5


def _goes_on(log_ns: Int64, step: _Step) -> bool:
    if not log_ns[0] < step.log_ns - abs(step.size_ns) or not step.log_ns < log_ns[-1]:
        return False
    if step.size_ns < 0:
        return True
    between = (log_ns > step.log_ns - 0.9 * step.size_ns) & (log_ns < step.log_ns - 0.1 * step.size_ns)
    return bool(between.any())


def count_latched(stamps: Stamps, start_ns: int) -> int:
    log_ns, stamp_ns = stamps
    is_soon = (log_ns < start_ns + 2 * 10**9) | (len(log_ns) < _FEWEST)
    early = is_soon & (stamp_ns < start_ns - _JUMP_NS) & (stamps.age_ns > _JUMP_NS) & (stamps.age_ns < _LONGEST_UP_NS)
    count = int(early.sum())
    if count == len(log_ns) >= _FEWEST:  # nodes' starts, not a stream of messages
        return 0 if 0.5 < stamps.speed < 2 else count
    is_start = len(log_ns) < _FEWEST or (count < len(log_ns) / 2 and float(np.median(stamps.age_ns[~early])) < _JUMP_NS)
    return count if is_start else 0


def _special_notes(topic: str, stamps: Stamps, start_ns: int) -> Iterator[str]:
    log_ns, stamp_ns = stamps
    ages_ns = stamps.age_ns
    latched = count_latched(stamps, start_ns)
    if latched:
        oldest = format_duration(start_ns - int(stamp_ns.min()))
        yield (
            f"{counted(latched, 'message')} of {topic} {'was' if latched == 1 else 'were'} stamped up to {oldest} before the "
            "recording began: transient-local messages of nodes that started earlier, not an age"
        )
        return
    if len(log_ns) < _FEWEST:
        return
    age_ns = float(np.median(ages_ns))
    steps_ns = np.diff(stamp_ns) - np.diff(log_ns)
    jumps = steps_ns[np.abs(steps_ns) > _JUMP_NS]
    sizes_ns = {unit: 2**32 * unit_ns for unit, unit_ns in _COUNTERS.items()}
    over = {unit: int((np.abs(jumps + size) < size // 100).sum()) for unit, size in sizes_ns.items()}
    if any(over.values()):
        unit_name = max(over, key=over.__getitem__)
        yield f"stamps of {topic} ran over {counted(over[unit_name], 'time')}: a counter of 32 bits of {unit_name}"
        return
    speed = stamps.speed
    unit = next((unit for unit in _UNITS if abs(speed / unit - 1) < _SAME_SPEED), None)
    if unit is not None:
        way, written, right = _UNITS[unit]
        times = f"{max(unit, 1 / unit):,.0f} times too {way}"
        yield f"stamps of {topic} advance {times}: its driver writes {written} where {right} belong"
        return
    if abs(age_ns) > DAY_NS:
        return
    for ahead_ns, time in _AHEAD_NS.items():
        if -_AHEAD_WITHIN_NS / 2 < age_ns + ahead_ns < _AHEAD_WITHIN_NS:
            seconds = ahead_ns // 10**9
            yield (
                f"stamps of {topic} are {seconds} s ahead, as of a device on {time}: set its UTC offset (of PTP: currentUtcOffset), or let "
                f"its driver subtract {seconds} s"
            )
            return
    yield from _two_kinds(topic, ages_ns)


def _two_kinds(topic: str, ages_ns: Int64) -> Iterator[str]:
    ordered = np.sort(ages_ns)
    at = int(np.argmax(np.diff(ordered)))
    is_old = ages_ns > ordered[at]
    fewer = int(min(is_old.sum(), (~is_old).sum()))
    switches = int((np.diff(is_old.astype(np.int8)) != 0).sum())
    apart_ns = int(ordered[at + 1] - ordered[at])
    widths = int(ordered[at] - ordered[0]), int(ordered[-1] - ordered[at + 1])
    if apart_ns > max(_LEAST_STEP_NS / 2, *widths) and fewer >= _FEWEST // 2 and switches > max(_MOST_STEPS, fewer / 2):
        old, new = (format_duration(float(np.median(ages_ns[part]))) for part in (is_old, ~is_old))
        yield (
            f"{topic} has messages of two kinds by turns, perhaps of two publishers: {int(is_old.sum()):,} with an age of {old}, "
            f"{int((~is_old).sum()):,} of {new}"
        )


def _steps(topic: str, stamps: Stamps) -> list[_Step]:
    ages_ns = stamps.age_ns
    if len(ages_ns) < _FEWEST or abs(float(np.median(ages_ns))) > DAY_NS:
        return []
    changes_ns = np.diff(ages_ns)
    least_ns = max(_LEAST_STEP_NS, _STEP_SPREADS * 1.4826 * float(np.median(np.abs(changes_ns))))
    jumps = (np.flatnonzero(np.abs(changes_ns) > least_ns) + 1).tolist()
    edges = [0, *jumps, len(ages_ns)]
    levels = [float(np.median(ages_ns[start:stop])) for start, stop in pairwise(edges)]
    return [
        _Step(
            topic,
            int(stamps.log_ns[at]),
            round(levels[number + 1] - levels[number]),
            int(stamps.stamp_ns[at] - stamps.stamp_ns[at - 1]),
            round(levels[number + 1]),
        )
        for number, at in enumerate(jumps)
        if abs(levels[number + 1] - levels[number]) > least_ns
        and at - edges[number] >= 5
        and edges[number + 2] - at >= 5
    ]


def growth_since_ns(log_ns: Int64, stamp_ns: Int64) -> int | None:
    """Return the log time since which the age grows to the end; None of another course.

    A steady age and a straight rise are fitted to the medians of parts (least squares), for each part in which the rise may begin.
    """
    ages_ns = log_ns - stamp_ns
    if len(ages_ns) < 2 * _AGE_PARTS or abs(float(np.median(ages_ns))) > DAY_NS:
        return None
    start_ns, end_ns = age_course(ages_ns)
    if end_ns < max(_GROWTH * start_ns, start_ns + _LEAST_GROWTH_NS):
        return None
    levels_ns = np.array([np.median(part) for part in np.array_split(ages_ns, _AGE_PARTS)])
    if np.ptp(levels_ns) == 0:
        return None
    middles, firsts = np.arange(_AGE_PARTS) + 0.5, np.arange(0, _AGE_PARTS - _FEWEST_RISING, 0.5)
    fits = [float(np.corrcoef(levels_ns, np.maximum(middles - first, 0))[0, 1]) for first in firsts]
    best = int(np.argmax(fits))
    return int(log_ns[int(len(log_ns) * firsts[best] / _AGE_PARTS)]) if fits[best] > _LEAST_FIT else None


def age_course(age_ns: Int64) -> tuple[float, float]:
    """Return the ages at the start and at the end: medians of up to five messages."""
    count = min(max(len(age_ns) // _AGE_PARTS, 1), 5)
    return float(np.median(age_ns[:count])), float(np.median(age_ns[-count:]))
