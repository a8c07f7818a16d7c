"""A trace as the public `mcap` reader gives it, and our columns of events as rows."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from event_cdr import unpack_event
from mcap.reader import make_reader
from trace_files import Event

from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns, Stage
from dds_trace.tracefile.reading.trace import Trace

FIELDS = (
    *("run_id", "sequence", "monotonic_ns", "scheduled_ns", "source_ns", "received_ns"),
    *("payload_bytes", "relay_id"),
)


def events_of(path: Path, stage: str) -> list[dict[str, int]]:
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages([f"/dds_trace/{stage}"])
        return [dict(zip(FIELDS, unpack_event(message.data), strict=True)) for _, _, message in messages]


def records_of(path: Path) -> list[tuple[str, bytes]]:
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        return [(channel.topic, message.data) for _, channel, message in messages]


def last_json(path: Path, name: str) -> dict[str, Any]:
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages([f"/dds_trace/{name}"])
        *_, (_, _, message) = messages
    found: dict[str, Any] = json.loads(message.data[8:].rstrip(b"\0"))
    return found


def rows(columns: EventColumns) -> list[tuple[int, ...]]:
    """The events as tuples of Python integers, in the order of `EVENT_DTYPE`."""
    return list(zip(*(getattr(columns, name).tolist() for name in FIELDS), strict=True))


def all_rows(trace: Trace) -> dict[Stage, list[tuple[int, ...]]]:
    return {stage: rows(columns) for stage, columns in trace.events.items()}


def columns(*events: Event) -> EventColumns:
    return EventColumns.from_records(np.array(list(events), EVENT_DTYPE))
