"""Recovery: a closed trace from a killed recorder's file and ring."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dds_trace.base.errors import OptionError, OutputExistsError, TraceFormatError
from dds_trace.base.files import flush_to_disk, mode_within, output_error
from dds_trace.base.threads import InlineExecutor
from dds_trace.base.units import counted
from dds_trace.tracefile.format.bag_metadata import MOST_TOPICS, RecordedTopic
from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.encoding import MESSAGE_HEADER, decode_string
from dds_trace.tracefile.format.events import SESSION_TOPIC, TOPIC_PREFIX, EventColumns, Stage
from dds_trace.tracefile.format.ring import (
    RING_SUFFIX,
    SLOT_DTYPE,
    STAGE_NUMBERS,
    RingContents,
    Slots,
    read_ring,
    ring_path,
    salvage_ring,
)
from dds_trace.tracefile.mcapfile.records import topic_of
from dds_trace.tracefile.reading.mcap_source import MANY_RECORDS, McapSource
from dds_trace.tracefile.reading.reader import read_trace_in_pieces
from dds_trace.tracefile.reading.source import Text
from dds_trace.tracefile.writing.event_chunks import CHUNK_BYTES, LIBRARY, Payload, PayloadQueue
from dds_trace.tracefile.writing.writer import TraceWriter

KILLED_SUFFIX = ".killed"

UNFINISHED_SUFFIX = ".recovering"
"""Suffix of the new trace until it is complete."""


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    path: Path
    recovered: Path | None
    originals: tuple[Path, ...] = ()
    file_events: int = 0
    ring_events: int = 0
    missing_events: int = 0
    dropped_events: int = 0
    torn_bytes: int = 0
    damaged_chunks: int = 0
    ring_fault: str | None = None

    def lines(self) -> list[str]:
        if self.recovered is None:
            whole = f"{self.path} is closed and whole ({counted(self.file_events, 'event')}); nothing to recover"
            fault = f"its damaged ring is left as it is: {self.ring_fault}"
            return [whole, fault] if self.ring_fault else [whole]
        torn = counted(self.torn_bytes, "byte")
        return [
            f"{counted(self.file_events, 'event')} in the file, {self.ring_events:,} more in the ring",
            f"{counted(self.missing_events, 'event')} missing, {self.dropped_events:,} dropped while recording",
            f"{torn} of an unfinished record and {counted(self.damaged_chunks, 'damaged chunk')} left out",
            *([f"only whole slots of the ring were used: {self.ring_fault}"] if self.ring_fault else []),
            *(f"The original is kept as {original}" for original in self.originals),
        ]


def recover(path: str | os.PathLike[str], destination: str | os.PathLike[str] | None = None) -> RecoveryReport:
    """Make a closed trace of a cut off one and its ring, without changing a byte of either.

    What is whole is used: only the ring if the file is gone, only the file if the ring is, and whole slots of a damaged ring.

    Args:
        path: a `.mcap` file, or a rosbag2 folder of ours, that was not closed; or its ring.
        destination: the new `.mcap` file. Without it the new file replaces the old one, which is renamed to
            `NAME.mcap.killed`, its ring to `NAME.mcap.killed.ring`; a kill at any moment leaves a readable trace.

    Raises:
        TraceFormatError: `path` is not a trace of ours, or neither file nor ring has a session, or the new file cannot be read.
        OptionError: the trace is still being recorded.
        OutputExistsError: `destination` exists already.
        OutputError: the new file cannot be written.
    """
    path, destination = Path(path), None if destination is None else Path(destination)
    if path.name.endswith(RING_SUFFIX):
        path = path.with_name(path.name.removesuffix(RING_SUFFIX))
    trace = path / f"{path.name}_0.mcap" if path.is_dir() else path
    if destination is not None and os.path.lexists(destination):
        raise OutputExistsError(f"{destination} is there already; choose another name")
    killed = _inspect(trace)
    if killed.is_whole:
        # Killed between the footer and the deletion of the ring.
        if killed.report.ring_fault is None:
            ring_path(trace).unlink(missing_ok=True)
        return replace(killed.report, path=path)
    ring = killed.ring
    report = replace(
        killed.report,
        path=path,
        recovered=destination or path,
        originals=tuple(file for file in (trace, ring_path(trace)) if file.exists()),
        ring_events=len(ring.slots) if ring else 0,
        missing_events=killed.report.missing_events + (ring.missing_events if ring else 0),
        dropped_events=max(killed.session.dropped_events, ring.dropped_events if ring else 0),
    )
    unfinished = destination or trace.with_name(trace.name + UNFINISHED_SUFFIX)
    try:
        unfinished.unlink(missing_ok=True)
        writer = _write(unfinished, killed, report)
        _check_readable(unfinished, report)
        if destination is not None:
            return report
        originals = _swap_files(trace, unfinished)
        if path != trace:
            writer.write_metadata(trace, killed.mode, fsync=True)
        flush_to_disk(trace.parent)
    except OSError as err:
        raise output_error(unfinished, err) from err
    return replace(report, originals=originals)


@dataclass(frozen=True, slots=True)
class _KilledTrace:
    trace: Path
    report: RecoveryReport
    is_closed: bool
    session: Session
    ring: RingContents | None

    @property
    def mode(self) -> int:
        original = self.trace if self.trace.exists() else ring_path(self.trace)
        return mode_within(original.stat().st_mode)

    @property
    def is_whole(self) -> bool:
        return self.is_closed and (self.ring is None or not len(self.ring.slots))


def _inspect(trace: Path) -> _KilledTrace:
    ring_file = ring_path(trace)
    report, is_closed, sessions = RecoveryReport(trace, None), False, list[Session]()
    if trace.exists() or not ring_file.exists():
        report, is_closed, sessions = _read_file(trace)
    tickets = report.file_events + report.missing_events
    ring, fault = _read_ring(ring_file, tickets, sessions[-1] if sessions else None)
    if ring is not None and ring.recording:
        raise OptionError(f"{trace} is still being recorded; stop the recorder first")
    if ring is not None and sessions and ring.session.session_id not in {session.session_id for session in sessions}:
        raise TraceFormatError(
            ring_file, f"this ring belongs to another recording than {trace.name}; move one of them away"
        )
    if ring is None and not sessions:
        raise TraceFormatError(trace, "ends before its session description and has no whole ring: it holds no event")
    session = sessions[-1] if sessions or ring is None else ring.session
    return _KilledTrace(trace, replace(report, ring_fault=fault), is_closed, session, ring)


def _read_file(trace: Path) -> tuple[RecoveryReport, bool, list[Session]]:
    with closing(_Salvage(trace)) as salvage:
        sessions = [
            Session.from_json(text, trace)
            for item in salvage.items()
            if isinstance(item, Text) and item.topic == SESSION_TOPIC and (text := _text(item))
        ]
        walk = salvage.walk
    report = RecoveryReport(
        trace,
        None,
        file_events=salvage.events,
        missing_events=salvage.written_events - salvage.events,
        torn_bytes=walk.torn_bytes,
        damaged_chunks=walk.damaged_chunks,
    )
    return report, walk.closed, sessions


def _read_ring(ring: Path, events_in_trace: int, session: Session | None) -> tuple[RingContents | None, str | None]:
    if not ring.exists():
        return None, None
    try:
        contents = read_ring(ring, events_in_trace)
    except TraceFormatError as damaged:
        return salvage_ring(ring, events_in_trace, session), damaged.what
    except OSError as err:
        return None, f"it cannot be read ({err.strerror})"
    return contents, contents.fault if contents else None


def _text(item: Text) -> str:
    try:
        return decode_string(item.data)
    except ValueError:
        return ""


def _salvaged(trace: Path) -> Iterator[Slots | Text | Payload]:
    if trace.exists():
        with closing(_Salvage(trace)) as salvage:
            yield from salvage.items()


def _write(unfinished: Path, killed: _KilledTrace, report: RecoveryReport) -> TraceWriter:
    counts = {
        "file_events": report.file_events,
        "ring_events": report.ring_events,
        "missing_events": report.missing_events,
    }
    session = replace(
        killed.session, dropped_events=report.dropped_events, extra={**killed.session.extra, "recovered": counts}
    )
    payloads = PayloadQueue()
    with TraceWriter(unfinished, killed.session, mode=killed.mode) as writer:
        for item in _salvaged(killed.trace):
            if isinstance(item, Text):
                if text := _text(item):
                    writer.write_text(item.topic, text, item.log_time_ns)
            elif isinstance(item, Payload):
                payloads.put(item)
                if payloads.waiting_bytes > CHUNK_BYTES:
                    _write_payloads(writer, payloads)
            else:
                writer.write_events(item)
        _write_payloads(writer, payloads)
        if killed.ring is not None:
            writer.write_events(killed.ring.slots)
        writer.write_text(SESSION_TOPIC, session.to_json(), writer.time_range_ns[1])
        writer.finish()
    return writer


def _write_payloads(writer: TraceWriter, payloads: PayloadQueue) -> None:
    while batch := payloads.first():
        writer.write_payloads(batch)
        payloads.remove(batch)


def _check_readable(unfinished: Path, report: RecoveryReport) -> None:
    """Read the new trace as an analysis does; remove it and raise a `TraceFormatError` unless it has every event."""
    events = 0

    def count(piece: Mapping[Stage, EventColumns]) -> None:
        nonlocal events
        events += sum(map(len, piece.values()))

    expected, fault = report.file_events + report.ring_events, None
    try:
        read_trace_in_pieces(unfinished, count)
    except TraceFormatError as err:
        fault = err.what
    if fault is None and events != expected:
        fault = f"{events:,} of {counted(expected, 'event')}"
    if fault is not None:
        unfinished.unlink()
        raise TraceFormatError(
            report.path,
            f"what was recovered cannot be read ({fault}); file and ring are as they were, please report this",
        )


def _swap_files(trace: Path, unfinished: Path) -> tuple[Path, ...]:
    """Rename the old files and give the name to the new one, so that a trace exists at every moment.

    The ring is renamed last: to the new file, which has all its events, it adds nothing.
    """
    with unfinished.open("rb") as stream:
        os.fsync(stream.fileno())
    backup = trace.with_name(trace.name + KILLED_SUFFIX)
    number = 1
    while os.path.lexists(backup) or os.path.lexists(ring_path(backup)):
        number += 1
        backup = trace.with_name(f"{trace.name}{KILLED_SUFFIX}{number}")
    originals: tuple[Path, ...] = ()
    if trace.exists():
        try:
            os.link(trace, backup)
        except OSError:  # a file system without hard links (FAT): for a moment only the backup exists
            trace.rename(backup)
        originals = (backup,)
    unfinished.replace(trace)
    ring = ring_path(trace)
    if not ring.exists():
        return originals
    return (*originals, ring.rename(ring_path(backup)))


_NUMBER_OF_STAGE = {stage: number for number, stage in STAGE_NUMBERS.items()}


class _Salvage(McapSource):
    """One-time source of the events (`SLOT_DTYPE` without tickets), texts and payloads of a file that a recorder left."""

    def __init__(self, path: Path) -> None:
        self._payload_topics: dict[int, RecordedTopic] = {}
        self._payloads: list[Payload] = []
        super().__init__(path, InlineExecutor())
        self.events = 0

    def items(self) -> Iterator[Slots | Text | Payload]:
        library = self.walk.header.library if self.walk.header else LIBRARY  # a damaged header: the content decides
        if not library.startswith(LIBRARY):
            raise TraceFormatError(
                self._path, f"was written by {library!r}, not by dds-trace; `mcap recover` closes such files"
            )
        for batch in self.batches():
            for stage, records in batch.events:
                self.events += len(records)
                slots = np.zeros(len(records), SLOT_DTYPE)
                slots["event"], slots["stage"] = records.view(SLOT_DTYPE["event"]), _NUMBER_OF_STAGE[stage]
                yield slots
            yield from batch.texts
            payloads, self._payloads = self._payloads, []
            yield from payloads
        refusal = MANY_RECORDS if self.steps_left < self.walk.headers else self.refusal
        if refusal:
            raise TraceFormatError(self._path, f"{refusal}; not recovered")

    def _add_other(self, channel_id: int, log_time_ns: int, content: memoryview) -> None:
        topic, declared = self._payload_topics.get(channel_id), self._channels.get(channel_id)
        if topic is None and declared is not None and len(self._payload_topics) < MOST_TOPICS:
            has_type = declared.record.schema_id in self._channels.schemas
            if has_type and not declared.topic.startswith(TOPIC_PREFIX):
                topic = self._payload_topics[channel_id] = topic_of(declared.record, self._channels.schemas)
        if topic is not None:
            self._payloads.append(Payload(topic, bytes(content[MESSAGE_HEADER.size :]), log_time_ns))
