"""What is said of a recording, in one frame.

`seen` rests on times, numbers, stamps and sizes alone: a hole with its start and length, regular gaps, a changed rate. `counted` is what a reading shows to be missing, within `low` to
`high`; the reading `all` is their union, and messages are missing where its `low` is above 0. `explained` is a test that its rivals fail.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dds_trace.analyzer.model.metrics import frame_schema
from dds_trace.base.units import SECOND_NS, clock_words, counted, first_of, format_rate

from .bounds import FEWEST, MOST, NEAR, PATTERN, SHOWN
from .clocks import Note
from .losses import ORIGINAL, Losses, TopicTimes
from .periods import Int64, find_grid, rate_changes, without_queues
from .quantiles import median
from .recorded import NONE

ALL_READINGS = "all"
OBSERVATION_SCHEMA = frame_schema(
    "recording:str topic:str kind:str reading:str low:u64 high:u64 start_s:f64 duration_s:f64 words:str"
)
READ_BY = {
    "stamps": "by the header stamps",
    "sequence": "by sequence numbers",
    "period": "by the rate of arrival",
    "recorder": "by the recorder's counts",
    "tap": "by the tap's counts",
    ORIGINAL: "by the counts of the damaged original",
    ALL_READINGS: "by all readings",
}
_MOST_HOLES = 1000
"""Holes of a topic that are listed, the longest: what is shorter is counted."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One row: a hole (`start_s`), a count, or an explanation; `topic` is empty for what all topics show."""

    topic: str
    kind: str
    reading: str = ""
    low: int | None = None
    high: int | None = None
    start_s: float | None = None
    duration_s: float | None = None
    words: str = ""


def observe(topic: str, losses: Losses, start_ns: int) -> Iterator[Observation]:
    """Yield what is counted and seen of one topic of a recording that began at `start_ns`."""
    for name, low, high in [
        *((reading.name, reading.low, reading.high) for reading in losses.readings),
        (ALL_READINGS, losses.low, losses.high),
    ]:
        if losses.readings:
            yield Observation(topic, "counted", name, low, high, words=READ_BY[name])
    holes = losses.holes.at(np.sort(np.argsort(-losses.holes.duration_ns, kind="stable")[:_MOST_HOLES]))
    counts = zip(holes.low.tolist(), holes.missing.tolist(), holes.seconds(start_ns), strict=True)
    for low, missing, (start_s, duration_s) in counts:
        yield Observation(topic, "seen", losses.evidence, low, missing, start_s, duration_s, "nothing came")


def regular_gaps(times_ns: Int64) -> tuple[int, int] | None:
    """Return after how many messages each a shorter gap of how many periods comes; None of other gaps, as of batches."""
    grid = find_grid(times_ns)
    at = np.flatnonzero(grid[1] > 1) if grid else np.empty(0, np.int64)
    if grid is None or len(at) < FEWEST:
        return None
    apart, lengths = np.diff(at), grid[1][at]
    distance, length = round(median(apart)), round(median(lengths))
    is_alike = min((apart == distance).mean(), (lengths == length).mean()) >= MOST
    is_throughout = distance * len(at) > (1 - NEAR) * len(grid[1])
    return (distance, length) if is_alike and is_throughout and distance > length else None


def rate_stretches(times_ns: Int64) -> list[tuple[int, float]]:
    """Return when each rate begins, and the rate."""
    intervals_ns = np.diff(times_ns)
    ratio, _ = without_queues(intervals_ns / max(median(intervals_ns), 1.0))
    stretches = list[tuple[int, float]]()
    for start, stop in pairwise([0, *rate_changes(ratio), len(ratio)]):
        rate_hz = SECOND_NS / max(median(intervals_ns[start:stop]), 1.0)
        is_same = stretches and abs(rate_hz / stretches[-1][1] - 1) <= NEAR / 2
        if stop - start >= PATTERN and not is_same:
            stretches.append((int(times_ns[start]), rate_hz))
    return stretches


def rhythm_notes(topic: str, times: TopicTimes, start_ns: int) -> Iterator[Note]:
    """Yield regular gaps, and rates that change, of a steady topic; whatever the cause."""
    if gaps := regular_gaps(np.sort(times.stamp_ns[times.stamp_ns != NONE])) or regular_gaps(times.log_ns):
        distance, length = gaps
        lost = counted(length - 1, "message")
        words = f"an interval of {length} periods after every {distance} messages: {lost} lost each time, or never sent"
        yield Note(f"{topic}: {words}", topic, "seen")
    (_, first_hz), *others = rate_stretches(times.log_ns) or [(0, 0.0)]
    if others:
        changes = [f"{format_rate(hz)} from {clock_words((at - start_ns) / SECOND_NS)}" for at, hz in others]
        yield Note(f"{topic}: {format_rate(first_hz)}, then {', '.join(first_of(changes, SHOWN))}", topic, "seen")


def has_losses(observations: Sequence[Observation]) -> bool:
    return any(row.kind == "counted" and row.reading == ALL_READINGS and row.low for row in observations)
