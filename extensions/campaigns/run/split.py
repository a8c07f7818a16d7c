"""A relay's trace of many runs, split into one for each cell.

The parts keep `session_id` and clock anchor: a reader sees one recording over several files.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import mode_within, replacing
from dds_trace.tracefile.format.events import HOST_TOPIC, SESSION_TOPIC, WIRE_TOPIC
from dds_trace.tracefile.format.ring import Slots
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.reading.trace import Trace
from dds_trace.tracefile.writing.event_chunks import slots_in_time
from dds_trace.tracefile.writing.writer import TraceWriter

from ..plan.link import COLUMNS, Drive, LinkReport
from .outage import OutageReport

_SAMPLE_MARGIN_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class CellPart:
    """The part for one cell; the link's counters, each change of its drive, and the outage become host samples."""

    run_id: int
    path: Path
    link: LinkReport | None = None
    drive: Drive | None = None
    outage: OutageReport | None = None


def split_relay_trace(segment: Path, parts: list[CellPart]) -> dict[int, int]:
    """Write the file of each part with events; return run id -> its events. Only a trace is no `TraceFormatError`."""
    trace = read_trace(segment)
    if not trace.sessions:
        raise TraceFormatError(segment, "names no session, so its events have no clock; record the cells again")
    counts = {}
    for part in parts:
        slots = slots_in_time(
            {stage: columns.take(columns.run_id == part.run_id) for stage, columns in trace.events.items()}
        )
        counts[part.run_id] = len(slots)
        if len(slots):
            _write(part, trace, slots, mode_within(segment.stat().st_mode))
    return counts


def _write(part: CellPart, trace: Trace, slots: Slots, mode: int) -> None:
    session = trace.sessions[-1]
    times_ns = slots["monotonic_ns"] + np.int64(session.wall_ns(0))
    samples: list[tuple[int, Mapping[str, object]]] = [
        (time_ns, {name: value for name, value in sample.items() if name != "log_time_ns"})
        for sample in trace.host_samples
        if isinstance(time_ns := sample["log_time_ns"], int)
        and times_ns[0] <= time_ns <= times_ns[-1] + _SAMPLE_MARGIN_NS
    ]
    if part.link is not None:
        samples.append((session.wall_ns(part.link["monotonic_ns"]), part.link))
        if part.drive is not None and (started_ns := part.link["drive_started_ns"]) is not None:
            ends_ns = (int(slots["monotonic_ns"][index]) for index in (0, -1))
            samples += [
                (session.wall_ns(at_ns), {"monotonic_ns": at_ns, "link_now": dict(zip(COLUMNS, row, strict=True))})
                for at_ns, row in part.drive.between(started_ns, *ends_ns)
            ]
    if part.outage is not None:
        ended_ns = part.outage["ended_ns"]
        described = {"run_id": f"{part.run_id:016x}", **part.outage}
        samples.append((session.wall_ns(ended_ns), {"monotonic_ns": ended_ns, "outage": described}))
    samples.sort(key=lambda timed: timed[0])
    ends = np.searchsorted(times_ns, [time_ns for time_ns, _ in samples], side="right").tolist()
    with replacing(part.path) as draft, TraceWriter(draft, session, mode=mode) as writer:
        writer.write_text(SESSION_TOPIC, session.to_json(), session.wall_anchor_ns)
        written = 0
        for end, (time_ns, sample) in zip(ends, samples, strict=True):
            writer.write_events(slots[written:end])
            writer.write_text(HOST_TOPIC, json.dumps(sample), time_ns)
            written = end
        writer.write_events(slots[written:])
        run = f"{part.run_id:016x}"
        for text in trace.wire:
            if run == text.get("run_id") or text.get("run_ids") == [run]:
                writer.write_text(WIRE_TOPIC, json.dumps(text), int(times_ns[-1]))
        writer.finish()
