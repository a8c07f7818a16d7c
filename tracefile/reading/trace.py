"""A trace in memory, and how it is collected from batches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted, first_of

from ..format.descriptions import Run, Session
from ..format.encoding import decode_string
from ..format.events import (
    HOST_TOPIC,
    PUBLISHER_TOPIC,
    RUN_TOPIC,
    SESSION_TOPIC,
    TOPIC_PREFIX,
    WIRE_TOPIC,
    EventColumns,
    Stage,
)
from ..format.json_fields import JsonObject, parse_json
from ..format.ring import TICKET_MASK, RingContents, events_by_stage, read_ring, ring_path
from .source import Batch, Source, Text

FOREIGN_HINT = "; for recordings of others: `dds-trace bag PATH`"
"""End of the error about a whole recording that is not ours."""

_MOST_NOTES = 20

_NO_JSON_OBJECT = {
    HOST_TOPIC: ("host sample is not a JSON object", "host samples are not JSON objects"),
    WIRE_TOPIC: ("text about the wire is not a JSON object", "texts about the wire are not JSON objects"),
    PUBLISHER_TOPIC: ("text about a publisher is not a JSON object", "texts about publishers are not JSON objects"),
}
"""Words for one and for several unreadable messages."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One trace: a `.mcap` file (with its ring, if one was left) or a rosbag2 folder.

    Attributes:
        sessions, runs, publishers: the latest description of each, in order of appearance.
        parts: the sessions of a rotating recording, each file of it once: a merged file has several.
        events: of every stage, in file order; a stage may be empty.
        host_samples: the JSON objects of `/dds_trace/host`, each with its `log_time_ns` (wall clock, ns since 1970).
        wire: the JSON objects of `/dds_trace/wire` (`format.wire`).
        truncated: why the file ends early; everything complete before it is in `events`.
        ring_events: from the ring that a killed recorder left.
        unreadable_messages: on event topics, of wrong length or encoding.
        notes: one line for each other fact that a reader of the numbers should know.
    """

    path: Path
    sessions: tuple[Session, ...]
    runs: tuple[Run, ...]
    events: Mapping[Stage, EventColumns]
    host_samples: tuple[JsonObject, ...] = ()
    wire: tuple[JsonObject, ...] = ()
    publishers: tuple[JsonObject, ...] = ()
    truncated: str | None = None
    ring_events: int = 0
    unreadable_messages: int = 0
    notes: tuple[str, ...] = field(default=())
    parts: tuple[Session, ...] = ()

    @property
    def event_count(self) -> int:
        return sum(len(columns) for columns in self.events.values())


_MAX_BYTES = 4 << 20  # a session with every configuration file of its host is a few kilobytes


class TextCollector:
    """The latest description of each session and run, in order of first appearance, and the other texts."""

    def __init__(self) -> None:
        self.sessions: dict[int, Session] = {}
        self.parts: dict[tuple[int, object], Session] = {}
        self.runs: dict[int, Run] = {}
        self.host: list[JsonObject] = []
        self.wire: list[JsonObject] = []
        self.publishers: dict[tuple[str, str], JsonObject] = {}
        self.unreadable = Counter[str]()

    def add(self, text: Text) -> None:
        try:
            if text.topic == SESSION_TOPIC:
                session = Session.from_json(_string(text), text.path)
                self.sessions[session.session_id] = session
                if "part" in session.extra:
                    self.parts[session.session_id, str(session.extra["part"])] = session
            elif text.topic == RUN_TOPIC:
                run = Run.from_json(_string(text), text.path)
                self.runs[run.run_id] = run
            elif text.topic in (HOST_TOPIC, WIRE_TOPIC, PUBLISHER_TOPIC):
                self._add_object(text)
        except TraceFormatError as err:
            raise TraceFormatError(err.path, err.what, text.offset) from err
        except RecursionError as err:
            what = f"the JSON of a message of {text.topic} is nested deeper than in any description"
            raise TraceFormatError(text.path, what, text.offset) from err

    def add_ring_session(self, described: Session, dropped_events: int) -> None:
        session = self.sessions.get(described.session_id, described)
        dropped_events = max(session.dropped_events, dropped_events)
        self.sessions[session.session_id] = replace(session, dropped_events=dropped_events)

    def _add_object(self, text: Text) -> None:
        try:
            value = parse_json(_string(text))
        except (TraceFormatError, ValueError):
            value = None
        if not isinstance(value, dict):
            self.unreadable[text.topic] += 1
        elif text.topic == HOST_TOPIC:
            self.host.append({**value, "log_time_ns": text.log_time_ns})
        elif text.topic == PUBLISHER_TOPIC:
            self.publishers[str(value.get("session_id")), str(value.get("publisher_id"))] = value
        else:
            self.wire.append(value)


def _string(text: Text) -> str:
    data = text.data
    if len(data) > _MAX_BYTES:
        raise TraceFormatError(text.path, f"a message of {text.topic} has {len(data)} bytes, more than any description")
    try:
        return decode_string(data)
    except ValueError as err:
        raise TraceFormatError(text.path, f"a message of {text.topic} is {err}") from err


@dataclass(frozen=True, slots=True)
class RingBeside:
    """Ring next to a file; its content is None if it cannot be read because of `fault`."""

    contents: RingContents | None
    fault: str | None = None

    def batch(self, events_in_file: int) -> Batch:
        """Return the events after the first `events_in_file`, which the recorder had written to the file."""
        if self.contents is None:
            return Batch(notes=[self.fault] if self.fault else [])
        slots = self.contents.slots
        slots = slots[(slots["mark"] & TICKET_MASK) >= events_in_file]
        batch = Batch(events_by_stage(slots))
        if self.contents.fault:
            batch.notes.append(f"the ring: {self.contents.fault}")
        if len(slots):
            last = int(slots["mark"][-1] & TICKET_MASK)
            missing = last + 1 - events_in_file - len(slots)
            if missing:
                batch.notes.append(f"{counted(missing, 'event is', 'events are')} neither in the file nor in its ring")
        if self.contents.recording:
            batch.notes.append("still being recorded; these are the events up to now")
        return batch


def ring_beside(file: Path) -> RingBeside | None:
    """Read the ring of a storage file, if it has an event; call this before the file is opened."""
    path = ring_path(file)
    try:
        contents = read_ring(path, 0)
    except FileNotFoundError:
        return None
    except (TraceFormatError, OSError) as err:
        return RingBeside(None, f"its ring is not used: {err}")
    return RingBeside(contents) if contents else None


@dataclass(slots=True)
class TraceBuilder:
    path: Path
    texts: TextCollector = field(default_factory=TextCollector)
    topics: set[str] = field(default_factory=set)
    unreadable: int = 0
    ring_events: int = 0
    notes: list[str] = field(default_factory=list)
    truncated: list[str] = field(default_factory=list)

    def batches_of(self, file: Path, source: Source, ring: RingBeside | None = None) -> Iterator[Batch]:
        """Yield the batches of a file, then the events that only its ring has; collect everything else."""
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
        """Check that the files are a trace; a file that was cut off before its first topic may be one."""
        ours = any(topic.startswith(TOPIC_PREFIX) for topic in self.topics)
        if not ours and (self.topics or not self.truncated):
            topics = ", ".join(sorted(self.topics)[:3]) or "none"
            what = f"not a trace: it has no topic {TOPIC_PREFIX}* (its topics: {topics})"
            hint = FOREIGN_HINT if self.topics else ""
            raise TraceFormatError(self.path, "; ".join([what, *self.notes[:1]]) + hint)

    def trace(self, events: Mapping[Stage, EventColumns]) -> Trace:
        self.check()
        for topic, count in self.texts.unreadable.items():
            self.notes.append(f"{counted(count, *_NO_JSON_OBJECT[topic])}; not used")
        return Trace(
            path=self.path,
            sessions=tuple(self.texts.sessions.values()),
            runs=tuple(self.texts.runs.values()),
            events=events,
            host_samples=tuple(self.texts.host),
            wire=tuple(self.texts.wire),
            publishers=tuple(self.texts.publishers.values()),
            truncated="; ".join(self.truncated) or None,
            ring_events=self.ring_events,
            unreadable_messages=self.unreadable,
            notes=tuple(first_of(self.notes, _MOST_NOTES, "more like these")),
            parts=tuple(self.texts.parts.values()),
        )
