"""A trace in memory, the value that passes from `tracefile` to `analyzer`, and how it is collected from batches."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted

from ..format.events import HOST_TOPIC, SESSION_TOPIC
from ..format.wire import WIRE_TOPIC
from .source import TOPIC_PREFIX
from .texts import TextCollector

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from ..format.descriptions import Run, Session
    from ..format.events import EventColumns, Stage
    from ..format.json_fields import JsonObject
    from .ring_events import RingBeside
    from .source import Batch, Source

FOREIGN_HINT = "; for recordings of others: `dds-analyze PATH --topics`"
"""End of the refusal of a recording that is whole and not ours."""

_MOST_NOTES = 20  # nobody reads more lines about one trace

_NO_JSON_OBJECT = {
    HOST_TOPIC: ("host sample is no JSON object", "host samples are no JSON objects"),
    WIRE_TOPIC: ("text about the wire is no JSON object", "texts about the wire are no JSON objects"),
}
"""Topic -> words of a note about one and about several unreadable messages of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One trace: a `.mcap` file (with the ring beside it, if one was left) or a rosbag2 folder.

    Attributes:
        path: the file or folder it was read from.
        sessions: the latest description of each recording process, in order of appearance.
        runs: the latest description of each run, in order of appearance.
        events: the events of every stage, in file order; a stage without events is there and empty.
        host_samples: the JSON objects of `/dds_trace/host`, each with its `log_time_ns` (wall clock, ns since 1970).
        wire: the JSON objects of `/dds_trace/wire`: records of messages, and counts of a relay (`format.wire`).
        truncated: the reason why the file ends early, or None; all that was complete before is in `events`.
        ring_events: number of the events that came from the ring that a killed recorder left behind.
        unreadable_messages: number of messages on event topics that are not events (wrong length or encoding).
        notes: one line for each other thing that a reader of the numbers should know.
    """

    path: Path
    sessions: tuple[Session, ...]
    runs: tuple[Run, ...]
    events: Mapping[Stage, EventColumns]
    host_samples: tuple[JsonObject, ...] = ()
    wire: tuple[JsonObject, ...] = ()
    truncated: str | None = None
    ring_events: int = 0
    unreadable_messages: int = 0
    notes: tuple[str, ...] = field(default=())

    @property
    def event_count(self) -> int:
        """Number of events of all stages."""
        return sum(len(columns) for columns in self.events.values())


@dataclass(slots=True)
class TraceBuilder:
    """Everything in a trace except its events, collected batch by batch.

    Attributes:
        path: the trace.
        texts: its descriptions and host samples.
        topics: its topics, ours or not.
        unreadable: number of messages on event topics that are not events.
        ring_events: number of events that only a ring has.
        notes: one line for each thing that a reader of the numbers should know.
        truncated: one reason for each of its files that ends early.
    """

    path: Path
    texts: TextCollector = field(default_factory=TextCollector)
    topics: set[str] = field(default_factory=set)
    unreadable: int = 0
    ring_events: int = 0
    notes: list[str] = field(default_factory=list)
    truncated: list[str] = field(default_factory=list)

    def batches_of(self, file: Path, source: Source, ring: RingBeside | None = None) -> Iterator[Batch]:
        """Yield the batches of a file, then a batch of the events that only its ring has; collect everything else."""
        for batch in source.batches():
            self._add(batch, file)
            yield batch
        self.topics |= source.topics
        if ring is not None:
            batch = ring.batch(source.written_events)
            self.ring_events += sum(len(events) for _, events in batch.events)
            self._add(batch, file)
            if ring.contents:
                self.texts.add_ring_session(ring.contents.session, ring.contents.dropped_events)
                self.topics.add(SESSION_TOPIC)
            yield batch

    def _add(self, batch: Batch, file: Path) -> None:
        self.unreadable += batch.unreadable
        for text in batch.texts:
            self.texts.add(text)
        which = "" if file == self.path else f"{file.name}: "  # a bag may have many
        self.notes += [which + note for note in batch.notes]
        if batch.truncated:
            self.truncated.append(which + batch.truncated)

    def check(self) -> None:
        """Check that the files are a trace; a file that was cut off before its first topic may be one.

        Raises:
            TraceFormatError: no topic is ours.
        """
        ours = any(topic.startswith(TOPIC_PREFIX) for topic in self.topics)
        if not ours and (self.topics or not self.truncated):
            topics = ", ".join(sorted(self.topics)[:3]) or "none"
            what = f"no trace: it has no topic {TOPIC_PREFIX}* (its topics: {topics})"
            hint = FOREIGN_HINT if self.topics else ""
            raise TraceFormatError(self.path, "; ".join([what, *self.notes[:1]]) + hint)

    def _first_notes(self) -> list[str]:
        more = len(self.notes) - _MOST_NOTES
        if more <= 0:
            return self.notes
        rest = counted(more, "more note like this", "more notes like these")
        return [*self.notes[:_MOST_NOTES], f"and {rest}"]

    def trace(self, events: Mapping[Stage, EventColumns]) -> Trace:
        """Return the trace with these events.

        Raises:
            TraceFormatError: as for `check`.
        """
        self.check()
        for topic, count in self.texts.unreadable.items():
            self.notes.append(f"{counted(count, *_NO_JSON_OBJECT[topic])}; not used")
        return Trace(
            path=self.path,
            sessions=self.texts.sessions,
            runs=self.texts.runs,
            events=events,
            host_samples=self.texts.host_samples,
            wire=self.texts.wire,
            truncated="; ".join(self.truncated) or None,
            ring_events=self.ring_events,
            unreadable_messages=self.unreadable,
            notes=tuple(self._first_notes()),
        )
