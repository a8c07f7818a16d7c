"""A relay's trace of many runs, taken apart into one trace for each cell.

A relay serves cell after cell without a restart and writes one file; a sweep hands on one file per device
and cell. What is taken out keeps the relay's session as it is (same `session_id`, same clock anchor), so a
reader sees one recording process whose trace is split over files.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.writer import Writer

from dds_trace.tracefile import (
    HOST_TOPIC,
    SESSION_TOPIC,
    Stage,
    TraceFormatError,
    __version__,
    pack_event,
    read_trace,
)
from dds_trace.tracefile.files import replacing
from dds_trace.tracefile.format.events import EVENT_DEFINITION, EVENT_SCHEMA_NAME
from dds_trace.tracefile.format.string_cdr import STRING_DEFINITION, STRING_SCHEMA_NAME, encode_string

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from dds_trace.tracefile import EventColumns, Session, Trace

_SAMPLE_MARGIN_NS = 1_000_000_000
"""A host sample belongs to a run that ended up to one sampling period before it."""


@dataclass(frozen=True, slots=True)
class Part:
    """What one cell wants of the relay's trace.

    Attributes:
        run_id: of the cell's run.
        path: the file to write.
        samples: further objects for the cell's host samples, such as what the emulated link did; `monotonic_ns` says when.
    """

    run_id: int
    path: Path
    samples: tuple[Mapping[str, Any], ...] = ()


def split_relay_trace(segment: Path, parts: list[Part]) -> dict[int, int]:
    """Writes each part's file, replacing what is there, and gives the number of its events by run id.

    A part without any event gets no file.

    Raises:
        TraceFormatError: `segment` is no trace, or names no session.
    """
    trace = read_trace(segment)
    if not trace.sessions:
        raise TraceFormatError(
            segment, "names no session, so its events have no clock; record the cells again"
        )
    counts = {}
    for part in parts:
        events = {
            stage: columns.take(columns.run_id == part.run_id) for stage, columns in trace.events.items()
        }
        counts[part.run_id] = sum(map(len, events.values()))
        if counts[part.run_id]:
            _write(part, trace, events)
    return counts


def _write(part: Part, trace: Trace, events: Mapping[Stage, EventColumns]) -> None:
    session = trace.sessions[-1]
    entries = [*_event_entries(session, events)]
    first_ns, last_ns = (limit(entry[0] for entry in entries) for limit in (min, max))
    samples: list[tuple[int, Mapping[str, Any]]] = [
        (sample["log_time_ns"], {name: value for name, value in sample.items() if name != "log_time_ns"})
        for sample in trace.host_samples
        if first_ns <= sample["log_time_ns"] <= last_ns + _SAMPLE_MARGIN_NS
    ]
    samples += [(session.wall_ns(sample["monotonic_ns"]), sample) for sample in part.samples]
    entries += [
        (log_time_ns, HOST_TOPIC, encode_string(json.dumps(sample))) for log_time_ns, sample in samples
    ]
    entries.append((session.wall_anchor_ns, SESSION_TOPIC, encode_string(session.to_json())))
    with replacing(part.path) as draft, draft.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", f"dds-trace {__version__}")
        channels = _Channels(writer)
        for sequence, (log_time_ns, topic, data) in enumerate(sorted(entries, key=lambda entry: entry[0])):
            writer.add_message(channels[topic], log_time_ns, data, log_time_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def _event_entries(
    session: Session, events: Mapping[Stage, EventColumns]
) -> Iterator[tuple[int, str, bytes]]:
    for stage, columns in events.items():
        log_times_ns = columns.monotonic_ns + np.int64(session.wall_anchor_ns - session.monotonic_anchor_ns)
        rows = zip(*(getattr(columns, name).tolist() for name in columns.__slots__), strict=True)
        for log_time_ns, row in zip(log_times_ns.tolist(), rows, strict=True):
            yield log_time_ns, stage.topic, pack_event(*row)


class _Channels(dict[str, int]):
    """Topic -> channel id, registered with the writer when first used."""

    def __init__(self, writer: Writer) -> None:
        super().__init__()
        self._writer = writer
        self._event_schema = writer.register_schema(EVENT_SCHEMA_NAME, "ros2msg", EVENT_DEFINITION.encode())
        self._string_schema = writer.register_schema(
            STRING_SCHEMA_NAME, "ros2msg", STRING_DEFINITION.encode()
        )

    def __missing__(self, topic: str) -> int:
        is_event = topic in {stage.topic for stage in Stage}
        schema = self._event_schema if is_event else self._string_schema
        self[topic] = self._writer.register_channel(topic, "cdr", schema)
        return self[topic]
