"""What is said of a recording, in one frame: what was seen, what is counted, what explains it.

`seen` rests on times, numbers, stamps and sizes alone: a hole at its place. `counted` is what a reading shows to be missing, within `low` to
`high`; the reading `all` is their union, and messages are missing where its `low` is above 0. `explained` is a test that its rivals fail.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dds_trace.analyzer.model.metrics import frame_schema

from .bounds import SECOND_NS
from .clocks import Note
from .losses import Losses

ALL_READINGS = "all"
OBSERVATION_SCHEMA = frame_schema(
    "recording:str topic:str kind:str reading:str low:u64 high:u64 start_s:f64 duration_s:f64 words:str"
)
_BY = {
    "stamps": "by the header stamps",
    "sequence": "by sequence numbers",
    "period": "by the rate of arrival",
    "recorder": "by the recorder's counts",
    "tap": "by the tap's counts",
    ALL_READINGS: "by all readings",
}
_MOST_HOLES = 1000
"""Holes of a topic that are listed, the longest: what is shorter is counted."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One row: a hole (`start_ns`), a count, or an explanation; `topic` is empty for what all topics show."""

    topic: str
    kind: str
    reading: str = ""
    low: int | None = None
    high: int | None = None
    start_ns: int | None = None
    duration_ns: int | None = None
    words: str = ""

    def row(self, recording: str, first_ns: int) -> dict[str, object]:
        return {
            "recording": recording,
            "topic": self.topic,
            "kind": self.kind,
            "reading": self.reading,
            "low": self.low,
            "high": self.high,
            "start_s": None if self.start_ns is None else (self.start_ns - first_ns) / SECOND_NS,
            "duration_s": None if self.duration_ns is None else self.duration_ns / SECOND_NS,
            "words": self.words,
        }


def observe(topic: str, losses: Losses) -> Iterator[Observation]:
    """Yield what is counted and seen of one topic."""
    for reading in losses.readings:
        yield Observation(topic, "counted", reading.name, reading.low, reading.high, words=_BY[reading.name])
    if losses.readings:
        yield Observation(topic, "counted", ALL_READINGS, losses.low, losses.high, words=_BY[ALL_READINGS])
    holes = losses.holes
    largest = np.sort(np.argsort(-holes.duration_ns, kind="stable")[:_MOST_HOLES])
    columns = (holes.low, holes.missing, holes.start_ns, holes.duration_ns)
    for low, missing, start_ns, duration_ns in zip(*(column[largest].tolist() for column in columns), strict=True):
        yield Observation(topic, "seen", losses.evidence, low, missing, start_ns, duration_ns, "nothing came")


def explained(notes: Sequence[Note]) -> Iterator[Observation]:
    for note in notes:
        yield Observation(note.topic, "explained", words=note.words)


def has_losses(observations: Sequence[Observation]) -> bool:
    """Return whether messages are missing by all readings of some topic."""
    return any(one.kind == "counted" and one.reading == ALL_READINGS and one.low for one in observations)
