"""A trace read back: all of it, or batch by batch, or only its descriptions.

Whatever the file is (ours, another tool's, unindexed, cut off, damaged, a rosbag2 folder), the same events come out.
"""

from __future__ import annotations

import os
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..errors import TraceFormatError
from ..format.events import SESSION_TOPIC, EventColumns, Stage
from ..units.counts import counted
from .columns import ColumnsBuilder
from .ring_events import ring_beside
from .source import TOPIC_PREFIX
from .storage import open_source, storage_files
from .texts import TextCollector
from .trace import Trace

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from .ring_events import RingBeside
    from .source import Batch, Source

_NOTES = 20  # nobody reads more lines about one trace
_MOST_WORKERS = 4  # beyond that, memory is what is waited for


def read_trace(path: Path) -> Trace:
    """Everything that a trace holds.

    Args:
        path: a `.mcap` file (with the ring beside it, if a killed recorder left one) or a rosbag2 folder.

    Raises:
        TraceFormatError: it is no trace, or a description in it cannot be read. A file that ends early or is
            damaged is no error: see `Trace.truncated` and `Trace.notes`.
    """
    gathered = _Gathered(path)
    files = storage_files(path)
    rings = [ring_beside(file) for file in files]
    with _workers() as pool, ExitStack() as opened:
        sources = [opened.enter_context(open_source(file, pool)) for file in files]
        expected = Counter[Stage]()
        for source in sources:
            expected.update(source.expected_events())
        columns = ColumnsBuilder(expected)
        for file, source, ring in zip(files, sources, rings, strict=True):
            for batch in gathered.batches_of(file, source, ring):
                for stage, events in batch.events:
                    columns.append(stage, events)
        return gathered.trace(columns.finish())


def iter_event_batches(path: Path) -> Iterator[tuple[Stage, EventColumns]]:
    """The events of a trace about a megabyte at a time, each stage's in file order; memory follows the chunk.

    Descriptions, notes and counts of what could not be used come from `read_descriptions` or `read_trace`.

    Raises:
        TraceFormatError: as `read_trace`, as soon as it is met.
    """
    gathered = _Gathered(path)
    for file in storage_files(path):
        ring = ring_beside(file)
        with _workers() as pool, open_source(file, pool) as source:
            for batch in gathered.batches_of(file, source, ring):
                for stage, events in batch.events:
                    yield stage, EventColumns.from_records(events)
    gathered.check()


def read_descriptions(path: Path) -> Trace:
    """The trace without its events: every stage is empty; sessions, runs, host samples are there.

    Chunks that hold only events are not unpacked where an index tells so.

    Raises:
        TraceFormatError: as `read_trace`.
    """
    gathered = _Gathered(path)
    for file in storage_files(path):
        ring = ring_beside(file)
        with _workers() as pool, open_source(file, pool, texts_only=True) as source:
            for _ in gathered.batches_of(file, source):
                pass
        if ring is not None:
            gathered.add_ring_session(ring)
    return gathered.trace({stage: EventColumns.empty() for stage in Stage})


def expected_events(path: Path) -> dict[Stage, int]:
    """About how many events of each stage a trace holds, by its statistics and without unpacking anything.

    For planning, not for results: without statistics it is as many as there is room for, and for every stage.

    Raises:
        TraceFormatError: as `read_trace`.
    """
    expected = Counter[Stage]()
    for file in storage_files(path):
        with _workers() as pool, open_source(file, pool) as source:
            expected.update(source.expected_events())
    return {stage: expected[stage] for stage in Stage}


def _workers() -> ThreadPoolExecutor:
    """Threads that unpack and check chunks beside the caller's: the libraries let each other run."""
    others = len(os.sched_getaffinity(0)) - 1
    return ThreadPoolExecutor(max(1, min(_MOST_WORKERS, others)), thread_name_prefix="read_trace")


@dataclass(slots=True)
class _Gathered:
    """All of a trace but its events."""

    path: Path
    texts: TextCollector = field(default_factory=TextCollector)
    topics: set[str] = field(default_factory=set)
    unreadable: int = 0
    ring_events: int = 0
    notes: list[str] = field(default_factory=list)
    truncated: list[str] = field(default_factory=list)

    def batches_of(self, file: Path, source: Source, ring: RingBeside | None = None) -> Iterator[Batch]:
        """The batches of one file, and one of the events that only its ring has; all else is kept here."""
        for batch in source.batches():
            self._add(batch, file)
            yield batch
        self.topics |= source.topics
        if ring is not None:
            batch = ring.batch(source.written_events)
            self.ring_events += sum(len(events) for _, events in batch.events)
            self._add(batch, file)
            self.add_ring_session(ring)
            yield batch

    def add_ring_session(self, ring: RingBeside) -> None:
        if ring.contents:
            self.texts.add_ring_session(ring.contents.session, ring.contents.dropped_events)
            self.topics.add(SESSION_TOPIC)

    def _add(self, batch: Batch, file: Path) -> None:
        self.unreadable += batch.unreadable
        for text in batch.texts:
            self.texts.add(text)
        which = "" if file == self.path else f"{file.name}: "  # a bag may have many
        self.notes += [which + note for note in batch.notes]
        if batch.truncated:
            self.truncated.append(which + batch.truncated)

    def check(self) -> None:
        """Raise an error if this is no trace. A file that was cut off before its first topic may be one."""
        ours = any(topic.startswith(TOPIC_PREFIX) for topic in self.topics)
        if not ours and (self.topics or not self.truncated):
            found = ", ".join(sorted(self.topics)[:3]) or "none"
            what = f"no trace: it has no topic {TOPIC_PREFIX}* (its topics: {found})"
            raise TraceFormatError(self.path, "; ".join([what, *self.notes[:1]]))

    def _first_notes(self) -> list[str]:
        more = len(self.notes) - _NOTES
        return (
            self.notes
            if more <= 0
            else [
                *self.notes[:_NOTES],
                f"and {counted(more, 'more note like this', 'more notes like these')}",
            ]
        )

    def trace(self, events: Mapping[Stage, EventColumns]) -> Trace:
        self.check()
        if self.texts.unreadable_samples:
            self.notes.append(
                counted(
                    self.texts.unreadable_samples,
                    "host sample is no JSON object; not used",
                    "host samples are no JSON objects; not used",
                )
            )
        return Trace(
            path=self.path,
            sessions=self.texts.sessions,
            runs=self.texts.runs,
            events=events,
            host_samples=self.texts.host_samples,
            truncated="; ".join(self.truncated) or None,
            ring_events=self.ring_events,
            unreadable_messages=self.unreadable,
            notes=tuple(self._first_notes()),
        )
