"""The clocks of a recording: which one its times are of, where one was set or ran over, which ages are none, and which topics became late."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from dds_trace.base.units import SECOND_NS, UNIT_NS, clock_words, counted, format_duration

from .bounds import DAY_NS, FEW, FEWEST, MOST, NEAR, NOTICED_NS, PATTERN, STEADY, WINDOW
from .holes import Holes
from .periods import Bools, Int64
from .quantiles import indices_of, median, quantile, spread, steps_of

SIMULATED_BEFORE_NS = SECOND_NS * SECOND_NS
"""September 2001: no recorder of today."""

_DAYS = {"years": 365.25, "days": 1}
_AHEAD_S = {37: "TAI", 18: "GPS time"}
_UNITS = {
    "ms": ("slowly", "milliseconds", "nanoseconds", 1 / UNIT_NS["ms"]),
    "us": ("slowly", "microseconds", "nanoseconds", 1 / UNIT_NS["us"]),
    "ns": ("fast", "nanoseconds", "microseconds", float(UNIT_NS["us"])),
}
_WHY_BACK = "a clock that was set back, a simulation that was reset, or joined files?"


def of_one_clock(log_ns: Int64) -> Bools:
    """Return which ascending log times are of the recording's clock, not at time 0 of a simulation."""
    gaps = indices_of(steps_of(log_ns) > WINDOW * DAY_NS)
    edges = np.concatenate([[0], gaps + 1, [len(log_ns)]])
    largest = int(np.argmax(steps_of(edges)))
    selected = np.zeros(len(log_ns), np.bool_)
    selected[edges[largest] : edges[largest + 1]] = True
    return selected


def apart(time_ns: float) -> str:
    if time_ns < WINDOW * DAY_NS:
        return format_duration(time_ns)
    days = time_ns / DAY_NS
    unit = "years" if days > _DAYS["years"] else "days"
    return f"{days / _DAYS[unit]:.0f} {unit}"


def set_back(backwards_ns: Mapping[str, int]) -> Iterator[str]:
    names = sorted((name for name in backwards_ns if backwards_ns[name]), key=lambda name: -backwards_ns[name])
    if names:
        are, size = "is" if len(names) == 1 else "are", format_duration(backwards_ns[names[0]])
        yield f"{and_more(names)} {are} not stored in order of time, up to {size} back: {_WHY_BACK}"


def reset_note(back_ns: int, at_ns: int, stamped: int) -> str:
    size, at = format_duration(back_ns), clock_words(at_ns / SECOND_NS)
    if stamped:
        return f"the recorder's clock was set back by {size} at {at}: the stamps of {counted(stamped, 'topic')} go on without a step"
    return f"the times of all topics begin again at {at}, {size} back: {_WHY_BACK}"


def find_resets(log_ns: Int64) -> list[int]:
    """Return the indices of stored log times that begin again: late messages leap to the others, and pieces in disorder fit together."""
    before_ns = np.minimum(log_ns[1:-2], log_ns[: -2 - 1])
    latest_ns = np.maximum(log_ns[2:-1], log_ns[2 + 1 :])
    resets: list[int] = (indices_of(latest_ns < before_ns - NOTICED_NS) + 2).tolist()
    if len(resets) > FEWEST:
        return []
    for at in resets:
        back_ns = int(log_ns[at - 1] - log_ns[at])
        is_beyond = log_ns[at:] >= log_ns[at - 1]
        again = at + int(np.argmax(is_beyond)) if is_beyond.any() else at
        apart_ns = int(log_ns[:at].min() - log_ns[at:].max())
        if log_ns[again] - log_ns[again - 1] > back_ns / 2 or 0 <= apart_ns < 2 * SECOND_NS:
            return []
    return resets


def backwards_ns(log_ns: Int64) -> int:
    step_ns = -int(np.diff(log_ns, prepend=log_ns[:1]).min())
    return step_ns if step_ns > SECOND_NS else 0


@dataclass(frozen=True, slots=True, eq=False)
class Stamps:
    """Messages of a topic with a stamp, by log time; `frame` differs between publishers."""

    log_ns: Int64
    stamp_ns: Int64
    frame: Int64

    @property
    def age_ns(self) -> Int64:
        return self.log_ns - self.stamp_ns

    def from_message(self, first: int) -> Stamps:
        return Stamps(self.log_ns[first:], self.stamp_ns[first:], self.frame[first:])

    @property
    def speed(self) -> float | None:
        """Return how fast stamps advance against the log times, by steps between messages of one frame; None where they do not agree."""
        order = np.argsort(self.frame, kind="stable")
        log_ns, stamp_ns, frame = self.log_ns[order], self.stamp_ns[order], self.frame[order]
        lag = FEWEST if len(log_ns) > 2 * FEWEST else 1
        is_one = (frame[lag:] == frame[:-lag]) & (log_ns[lag:] > log_ns[:-lag])
        if is_one.sum() < FEWEST // 2:
            return None
        speeds = (stamp_ns[lag:] - stamp_ns[:-lag])[is_one] / (log_ns[lag:] - log_ns[:-lag])[is_one]
        typical = median(speeds)
        agree = np.abs(speeds - typical) <= NEAR * abs(typical)
        return typical if 2 * agree.sum() > len(speeds) else None

    @property
    def repeats(self) -> bool:
        """Return whether stamps go back and then are stamps that were there: a recording that is played in a loop."""
        back = indices_of(steps_of(self.stamp_ns) < -SECOND_NS)
        if not len(back) or len(self.stamp_ns) < FEWEST:
            return False
        again = len(self.stamp_ns) - len(np.unique(self.stamp_ns))
        is_first = self.stamp_ns[back + 1] < self.stamp_ns[0] + SECOND_NS
        return bool(is_first.all() and again >= (1 - NEAR) * (len(self.stamp_ns) - back[0] - 1) > 0)


def count_history(stamps: Stamps, start_ns: int, usual_ns: float) -> int:
    """Return how many messages at the start were sent earlier (transient local): they come at once, and are older than what follows.

    `usual_ns` is the age of other topics, for one without a message that follows.
    """
    is_soon = stamps.log_ns < start_ns + 2 * SECOND_NS
    is_live = ~is_soon & (stamps.frame == stamps.frame[0])  # of the same publisher
    is_live = is_live if is_live.any() else ~is_soon
    live_ns = median(stamps.age_ns[is_live]) if is_live.any() else usual_ns
    older_ns = np.where(is_soon, stamps.age_ns - live_ns, 0)
    is_early = (older_ns > NOTICED_NS) & (older_ns < WINDOW * DAY_NS * FEWEST)
    count = len(is_early) if is_early.all() else int(np.argmin(is_early))
    if not count or older_ns[:count].max() < SECOND_NS:
        return 0
    sent_ns = int(np.ptp(stamps.stamp_ns[:count]))
    return count if count == 1 or 2 * int(stamps.log_ns[count - 1] - stamps.log_ns[0]) < sent_ns else 0


@dataclass(frozen=True, slots=True)
class Note:
    """What explains a topic's times, or all topics' (empty), or was seen of them."""

    words: str
    topic: str = ""
    kind: str = "explained"


@dataclass(slots=True)
class Clocks:
    """What the clocks of a recording did: why topics have no age, in a word, and by reason, and where a clock was set."""

    notes: list[Note] = field(default_factory=list)
    no_age: dict[str, str] = field(default_factory=dict)
    reasons: dict[str, list[str]] = field(default_factory=dict)
    set_over: Holes = field(default_factory=Holes)


@dataclass(frozen=True, slots=True)
class _Step:
    """The age of a topic's messages changes for good with the message of `log_ns`."""

    topic: str
    log_ns: int
    size_ns: int
    stamp_step_ns: int
    age_ns: int


def read_clocks(topics: Mapping[str, Stamps], unstamped: Sequence[Int64], start_ns: int, tick_ns: int) -> Clocks:
    """Return what the ages of topics show; they are without the history of messages that were sent earlier."""
    clocks = Clocks()
    steps: list[_Step] = []
    reasons = clocks.reasons
    offset_ns = _shared_offset(topics)
    for name, stamps in topics.items():
        reason = _no_age(stamps, start_ns, tick_ns, offset_ns)
        if reason:
            reasons.setdefault(reason, []).append(name)
            clocks.no_age[name] = _SHORT[reason]
        special = next(_special_notes(name, stamps), "") if reason in ("", "loop", "speed", "offset") else ""
        if special:
            if reason:
                reasons[reason].remove(name)
            clocks.notes.append(Note(special, name))
            continue
        if reason:
            continue
        own_steps = _steps(name, stamps)
        if len(own_steps) < FEWEST:
            steps += own_steps
        if not own_steps:
            clocks.notes += [Note(note, name) for note in _course_notes(name, stamps, start_ns)]
    clocks.notes += [Note(_WHY_NO_AGE[reason](names, topics)) for reason, names in reasons.items() if names]
    set_over = []
    while steps:
        same = [step for step in steps if _is_same(step, steps[0])]
        steps = [step for step in steps if step not in same]
        step_notes, is_of_recorder = _step_notes(same, topics, unstamped, start_ns)
        clocks.notes += step_notes
        set_over += [(same[0].log_ns - same[0].size_ns, same[0].log_ns)] * is_of_recorder
    starts, ends = zip(*sorted(set_over), strict=True) if set_over else ((), ())
    clocks.set_over = Holes.between(starts, ends)
    return clocks


def _shared_offset(topics: Mapping[str, Stamps]) -> float | None:
    """Return the age that all topics have to within a hundredth of it and jitter: of another clock."""
    ages_ns = [median(stamps.age_ns) for stamps in topics.values() if len(stamps.log_ns) >= FEWEST]
    if len(ages_ns) < 2 or any(_width_ns(stamps.age_ns) > NOTICED_NS for stamps in topics.values()):
        return None
    shared_ns = median(ages_ns)
    is_shared = abs(shared_ns) > SECOND_NS and np.ptp(ages_ns) < min(NOTICED_NS, FEW / 2 * abs(shared_ns))
    return shared_ns if is_shared else None


def _width_ns(ages_ns: Int64) -> float:
    return quantile(ages_ns, MOST) - quantile(ages_ns, 1 - MOST)


def _no_age(stamps: Stamps, start_ns: int, tick_ns: int, offset_ns: float | None) -> str:
    ages_ns, age_ns = stamps.age_ns, median(stamps.age_ns)
    if (ages_ns == 0).sum() >= MOST * len(ages_ns) and len(ages_ns) >= FEWEST:
        return "copy"
    if start_ns < SIMULATED_BEFORE_NS and -age_ns > DAY_NS:
        return "zero"
    if stamps.repeats:
        return "loop"
    speed = stamps.speed
    is_far = abs(age_ns) > DAY_NS
    if is_far and speed is not None and speed > 0 and abs(speed - 1) > FEW:
        return "speed"
    is_constant = len(ages_ns) >= FEWEST and _width_ns(ages_ns) < STEADY * abs(age_ns)
    is_shared = offset_ns is not None and abs(age_ns - offset_ns) < NOTICED_NS
    if is_far or is_shared or (is_constant and abs(age_ns) > WINDOW * SECOND_NS):
        return "offset"
    return "ticks" if tick_ns and abs(age_ns) < tick_ns else ""


def _of_offset(names: Sequence[str], topics: Mapping[str, Stamps]) -> str:
    ages_ns = {name: median(topics[name].age_ns) for name in names}
    ordered = sorted(names, key=lambda name: -abs(ages_ns[name]))
    age_ns = ages_ns[ordered[0]]
    way = "older than" if age_ns > 0 else "ahead of"
    who = f"all {len(topics)} topics" if 1 < len(names) == len(topics) else and_more(ordered)
    return (
        f"stamps of {who} are {apart(abs(age_ns))} {way} the log times: of another clock (a replay, or a clock that is not set), "
        "not an age"
    )


def _of_speed(names: Sequence[str], topics: Mapping[str, Stamps]) -> str:
    speed = f"{median([topics[name].speed or 0.0 for name in names]):.3g}"
    return f"stamps of {and_more(names)} advance {speed} s a second: a simulation that runs at {speed} of real time?"


_WHY_NO_AGE: Mapping[str, Callable[[Sequence[str], Mapping[str, Stamps]], str]] = {
    "copy": lambda names, _: (
        f"log times of {and_more(names)} are copies of the stamps{', as RealSense writes them (.db3)' if of_realsense(names) else ''}: there is no age"
    ),
    "zero": lambda names, _: (
        f"the log times begin at 0 (of the recording{', as RealSense writes them (.bag)' if of_realsense(names) else ', a simulation or a machine'}), "
        f"the stamps of {and_more(names)} do not: there is no age"
    ),
    "loop": lambda names, _: (
        f"stamps of {and_more(names)} come again: a recording that was replayed in a loop, not an age"
    ),
    "speed": _of_speed,
    "offset": _of_offset,
    "ticks": lambda names, _: (
        f"the log times advance in ticks (a simulation's clock?): ages of {and_more(names)} below a tick are unknown"
    ),
}
_SHORT = {
    "copy": "-",
    "zero": "other clock",
    "loop": "replay",
    "speed": "other clock",
    "offset": "other clock",
    "ticks": "below a tick",
}


def of_realsense(names: Sequence[str]) -> bool:
    return all(name.startswith("/device_") and "/sensor_" in name for name in names)


def and_more(names: Sequence[str]) -> str:
    return names[0] + (f" and {counted(len(names) - 1, 'more topic')}" if len(names) > 1 else "")


def _step_notes(
    steps: Sequence[_Step], topics: Mapping[str, Stamps], unstamped: Sequence[Int64], start_ns: int
) -> tuple[list[Note], bool]:
    first, moved = steps[0], sorted({step.topic for step in steps})
    is_of_stamps = first.stamp_step_ns < 0 or (first.size_ns < 0 and first.age_ns < -2 * NOTICED_NS)
    late_ns = 0 if is_of_stamps else max(first.size_ns, 0)
    at, size = clock_words((first.log_ns - late_ns - start_ns) / SECOND_NS), format_duration(abs(first.size_ns))
    if is_of_stamps:
        like = next((name for name in topics if name not in moved and _has_its_age(topics[name], first)), "")
        who = f"like {like}: of another publisher, a replay?" if like else "the clock that stamps them was set"
        return [
            Note(f"stamps of {name} jump 1 time against the log times, by {size} at {at}: {who}", name)
            for name in moved
        ], False
    others = [stamps.log_ns for name, stamps in topics.items() if name not in moved]
    witnesses = sum(_goes_on(log_ns, first) for log_ns in (*others, *unstamped))
    direction, became = ("forward", "later") if first.size_ns > 0 else ("back", "earlier")
    clock = f"the recorder's clock was set {direction} by {size} at {at}"
    if not witnesses and len(moved) > 1:
        return [Note(f"{clock}: the stamps of all {len(moved)} topics go on without a step")], True
    unsure = "" if witnesses else f", or {clock}: no other topic shows which"
    return [Note(f"{name} became {size} {became} at {at}{unsure}", name) for name in moved], False


def _is_same(step: _Step, other: _Step) -> bool:
    apart_ns, size_ns = abs(step.log_ns - other.log_ns), abs(other.size_ns)
    return apart_ns < size_ns / 2 + 2 * SECOND_NS and abs(step.size_ns - other.size_ns) < NEAR * size_ns


def _has_its_age(stamps: Stamps, step: _Step) -> bool:
    ages_ns = stamps.age_ns[stamps.log_ns < step.log_ns + 2 * SECOND_NS]
    return len(ages_ns) > 0 and 2 * float((np.abs(ages_ns - step.age_ns) < NEAR * abs(step.size_ns)).mean()) > 1


def _goes_on(log_ns: Int64, step: _Step) -> bool:
    if not log_ns[0] < step.log_ns - abs(step.size_ns) or not step.log_ns < log_ns[-1]:
        return False
    if step.size_ns < 0:
        return True
    edge_ns = NEAR / 2 * step.size_ns
    between = (log_ns > step.log_ns - step.size_ns + edge_ns) & (log_ns < step.log_ns - edge_ns)
    return bool(between.any())


def _special_notes(topic: str, stamps: Stamps) -> Iterator[str]:
    if len(stamps.log_ns) < FEWEST:
        return
    ages_ns, age_ns = stamps.age_ns, median(stamps.age_ns)
    steps_ns = steps_of(stamps.stamp_ns) - steps_of(stamps.log_ns)
    jumps = steps_ns[np.abs(steps_ns) > SECOND_NS]
    ranges_ns = {unit: np.iinfo(np.uint32).max * UNIT_NS[unit] for unit in _UNITS}
    over = {unit: int((np.abs(jumps + most_ns) < FEW / 2 * most_ns).sum()) for unit, most_ns in ranges_ns.items()}
    if any(over.values()):
        unit_name = max(over, key=over.__getitem__)
        yield f"stamps of {topic} ran over {counted(over[unit_name], 'time')}: a counter of 32 bits of {unit_name}"
        return
    speed = stamps.speed or 0.0
    unit = next((unit for unit in _UNITS.values() if abs(speed / unit[-1] - 1) < NEAR / 2), None)
    if unit is not None:
        way, written, right, factor = unit
        yield f"stamps of {topic} advance {max(factor, 1 / factor):,.0f} times too {way}: its driver writes {written} where {right} belong"
        return
    for seconds, time in _AHEAD_S.items():
        if abs(age_ns + seconds * SECOND_NS) < SECOND_NS / 2:
            yield (
                f"stamps of {topic} are {seconds} s ahead, as of a device on {time}: set its UTC offset (of PTP: currentUtcOffset), or let "
                f"its driver subtract {seconds} s"
            )
            return
    yield from _two_kinds(topic, ages_ns)


def _two_kinds(topic: str, ages_ns: Int64) -> Iterator[str]:
    ordered = np.sort(ages_ns)
    at = int(np.argmax(steps_of(ordered)))
    is_old = ages_ns > ordered[at]
    fewer = int(min(is_old.sum(), (~is_old).sum()))
    switches = int((steps_of(is_old.astype(np.int8)) != 0).sum())
    apart_ns = int(ordered[at + 1] - ordered[at])
    widths = int(ordered[at] - ordered[0]), int(ordered[-1] - ordered[at + 1])
    if apart_ns > max(NOTICED_NS, *widths) and fewer >= FEWEST // 2 and switches > max(FEWEST, fewer / 2):
        old, new = (format_duration(median(ages_ns[part])) for part in (is_old, ~is_old))
        yield (
            f"{topic} has messages of two kinds by turns, perhaps of two publishers: {int(is_old.sum()):,} with an age of {old}, "
            f"{int((~is_old).sum()):,} of {new}"
        )


def _steps(topic: str, stamps: Stamps) -> list[_Step]:
    ages_ns = stamps.age_ns
    if len(ages_ns) < FEWEST:
        return []
    changes_ns = steps_of(ages_ns)
    least_ns = max(2 * NOTICED_NS, FEWEST * spread(changes_ns))
    jumps = (indices_of(np.abs(changes_ns) > least_ns) + 1).tolist()
    if len(jumps) > FEWEST * WINDOW:  # more than a clock is set
        return []
    edges = [0, *jumps, len(ages_ns)]
    lengths = np.diff(edges)
    levels = [median(ages_ns[start:stop]) for start, stop in pairwise(edges)]
    spans = ([np.ptp(times[a:b]) for a, b in pairwise(edges)] for times in (stamps.log_ns, stamps.stamp_ns))
    is_burst = [2 * log_ns < stamp_ns for log_ns, stamp_ns in zip(*spans, strict=True)]  # a queue empties
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
        and min(lengths[number : number + 2]) > FEWEST // 2
        and not any(is_burst[number : number + 2])
    ]


def _course_notes(name: str, stamps: Stamps, start_ns: int) -> Iterator[str]:
    since_ns = growth_since_ns(stamps.log_ns, stamps.stamp_ns)
    first_age, last_age = map(format_duration, age_course(stamps.age_ns))
    if since_ns is not None:
        is_later = since_ns > stamps.log_ns[0]
        when = f"since {clock_words((since_ns - start_ns) / SECOND_NS)}" if is_later else "all the time"
        yield f"the age of {name} grows from {first_age} to {last_age}, {when}: a queue that fills, or a clock that runs at another speed"
    elif growth_since_ns(-stamps.log_ns[::-1], -stamps.log_ns[::-1] - stamps.age_ns[::-1]) is not None:
        yield f"the age of {name} falls from {first_age} to {last_age}: its clock ran at another speed, or a queue emptied; its early ages are wrong by it"


def growth_since_ns(log_ns: Int64, stamp_ns: Int64) -> int | None:
    """Return the log time since which the age grows to the end; None of another course.

    A steady age and a straight rise are fitted to the medians of parts (least squares), for each part in which the rise may begin.
    """
    ages_ns = log_ns - stamp_ns
    if len(ages_ns) < 2 * WINDOW or abs(median(ages_ns)) > DAY_NS:
        return None
    start_ns, end_ns = age_course(ages_ns)
    noise_ns = max(FEWEST * spread(steps_of(ages_ns)), NOTICED_NS / FEWEST)
    if end_ns < max(2 * start_ns, start_ns + noise_ns):
        return None
    levels_ns = np.array([median(part) for part in np.array_split(ages_ns, WINDOW)])
    if levels_ns[-1] < levels_ns[0] + noise_ns:
        return None
    middles, firsts = np.arange(WINDOW) + 1 / 2, np.arange(0, WINDOW - FEWEST, 1 / 2)
    fits = [float(np.corrcoef(levels_ns, np.maximum(middles - first, 0))[0, 1]) for first in firsts]
    best = int(np.argmax(fits))
    return int(log_ns[int(len(log_ns) * firsts[best] / WINDOW)]) if fits[best] > MOST else None


def age_course(age_ns: Int64) -> tuple[float, float]:
    """Return the ages at the start and at the end: medians of up to five messages."""
    count = min(max(len(age_ns) // PATTERN, 1), FEWEST // 2 + 1)
    return median(age_ns[:count]), median(age_ns[-count:])
