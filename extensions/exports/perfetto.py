"""One timeline of all devices for https://ui.perfetto.dev, written by the protobufs of the package `perfetto` (extra of that name).

A track for each device, below it lanes of round trips and topics; arrows lead from sending to reception. All times are of the wall
clock of the first device, the others' by the fits of their clocks.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.clocks.boots import ping_wall_offsets
from dds_trace.analyzer.clocks.lines import Int64
from dds_trace.analyzer.exports.kinds import write_file
from dds_trace.base.printable import printable

MOST_SLICES = 100_000
"""More messages are thinned evenly."""

_SEQUENCE = 1


class Slice(NamedTuple):
    """A stretch of time on a device; slices of one `message` are joined by an arrow in the order of time."""

    device: str
    lane: str
    name: str
    begin_ns: int
    end_ns: int
    message: int


def write_perfetto(analysis: Analysis, path: Path) -> None:
    write_slices(timeline_slices(analysis), path)


def write_slices(slices: Iterable[Slice], path: Path) -> None:
    """Write a timeline.

    Raises:
        ModuleNotFoundError: the extra is not installed.
    """
    from perfetto.protos.perfetto.trace.perfetto_trace_pb2 import TrackEvent  # noqa: PLC0415 - optional
    from perfetto.trace_builder.proto_builder import StreamingTraceProtoBuilder  # noqa: PLC0415 - optional

    tracks: dict[tuple[str, str, int], int] = {}
    free: dict[tuple[str, str], list[int]] = defaultdict(list)
    with path.open("wb") as file:
        builder = StreamingTraceProtoBuilder(file)

        def track(key: tuple[str, str, int], name: str, parent: int | None) -> int:
            if key not in tracks:
                tracks[key] = len(tracks) + 1
                packet = builder.create_packet()
                packet.trusted_packet_sequence_id = _SEQUENCE
                packet.track_descriptor.uuid, packet.track_descriptor.name = tracks[key], printable(name)
                if parent is not None:
                    packet.track_descriptor.parent_uuid = parent
                builder.write_packet(packet)
            return tracks[key]

        for event in sorted(slices, key=lambda part: (part.begin_ns, part.end_ns)):
            ends = free[event.device, event.lane]
            lane = next((number for number, end_ns in enumerate(ends) if end_ns <= event.begin_ns), len(ends))
            ends[lane : lane + 1] = [event.end_ns]
            device = track((event.device, "", 0), event.device, None)
            uuid = track((event.device, event.lane, lane), event.lane, device)
            for kind, at_ns in (
                (TrackEvent.TYPE_SLICE_BEGIN, event.begin_ns),
                (TrackEvent.TYPE_SLICE_END, event.end_ns),
            ):
                packet = builder.create_packet()
                packet.timestamp, packet.trusted_packet_sequence_id = at_ns, _SEQUENCE
                packet.track_event.type, packet.track_event.track_uuid = kind, uuid
                if kind == TrackEvent.TYPE_SLICE_BEGIN:
                    packet.track_event.name = printable(event.name)
                    packet.track_event.flow_ids.append(event.message)
                builder.write_packet(packet)


def timeline_slices(analysis: Analysis) -> Iterator[Slice]:
    clock = _Reference(analysis)
    yield from _roundtrips(analysis, clock)
    yield from _topics(analysis, clock)


def _roundtrips(analysis: Analysis, clock: _Reference) -> Iterator[Slice]:
    names = ["run_id", "sequence", "vendor", "data_type", "payload_bytes", "ping_device", "relay_device"]
    times = ["publish_ns", "receive_ns", "outbound_ns", "return_ns"]
    rows = _thinned(analysis.scan_roundtrips().filter(outcome="completed").select(*names, *times).collect())
    for part in rows.partition_by("ping_device", maintain_order=True):
        shift_ns = clock.wall_ns(part["ping_device"][0], part["publish_ns"].to_numpy()) - part["publish_ns"].to_numpy()
        shifted = part.with_columns(pl.col("publish_ns", "receive_ns") + pl.Series(shift_ns))
        for row in shifted.iter_rows(named=True):
            kind = f"{row['data_type']} {row['payload_bytes']} B"
            message = hash((row["run_id"], row["sequence"])) & (1 << 63) - 1
            track, name = f"{row['vendor']} {kind}", f"{kind} {row['sequence']}"
            yield Slice(row["ping_device"], track, name, row["publish_ns"], row["receive_ns"], message)
            if row["relay_device"] is not None and row["outbound_ns"] is not None:
                begin_ns, end_ns = row["publish_ns"] + row["outbound_ns"], row["receive_ns"] - row["return_ns"]
                yield Slice(row["relay_device"], track, name, begin_ns, end_ns, message)


def _topics(analysis: Analysis, clock: _Reference) -> Iterator[Slice]:
    names = ["run_id", "sequence", "data_type", "ping_device", "relay_device"]
    times = ["publish_ns", "one_way_ns", "stamp_to_publish_ns"]
    rows = _thinned(analysis.topic_messages.select(*names, *times).filter(pl.col("one_way_ns").is_not_null()))
    for part in rows.partition_by("ping_device", maintain_order=True):
        sent_ns = part["publish_ns"].to_numpy()
        on_wall = part.with_columns(publish_ns=pl.Series(clock.wall_ns(part["ping_device"][0], sent_ns)))
        for row in on_wall.iter_rows(named=True):
            message = hash((row["run_id"], row["sequence"])) & (1 << 63) - 1
            topic, publish_ns = row["data_type"], row["publish_ns"]
            name = f"{topic} {row['sequence']}"
            if (row["stamp_to_publish_ns"] or 0) > 0:
                stamped_ns = publish_ns - row["stamp_to_publish_ns"]
                yield Slice(row["ping_device"], topic, f"{name} stamp", stamped_ns, publish_ns, message)
            taken_ns = publish_ns + row["one_way_ns"]
            yield Slice(row["relay_device"], topic, f"{name} one way", publish_ns, taken_ns, message)


def _thinned(rows: pl.DataFrame) -> pl.DataFrame:
    return rows.gather_every(-(-len(rows) // MOST_SLICES)) if len(rows) else rows


class _Reference:
    """The wall clock of the first device, on which the instants of all devices are expressed."""

    def __init__(self, analysis: Analysis) -> None:
        self._zero_ns = {
            session.device: session.wall_anchor_ns - session.monotonic_anchor_ns for session in analysis.sessions
        }
        pings = ping_wall_offsets(analysis.sessions, analysis.runs)
        knots = analysis.details.clock_knots.filter(pl.col("run_id").is_in(list(pings))).sort("at_ns")
        self._first = knots["ping_device"][0] if len(knots) else next(iter(self._zero_ns), "")
        first_knots = knots.filter(pl.col("ping_device") == self._first)
        self._knots = first_knots.partition_by("relay_device", as_dict=True, maintain_order=True)

    def wall_ns(self, device: str, monotonic_ns: Int64) -> Int64:
        """Return instants of a device's monotonic clock; of one without a fit by its own wall clock."""
        knots = self._knots.get((device,))
        if device == self._first or knots is None:
            return monotonic_ns + self._zero_ns.get(device, 0)
        offset_ns, at_ns = knots["offset_ns"].to_numpy(), knots["at_ns"].to_numpy()
        first_ns = int(offset_ns[0])
        on_first_ns = monotonic_ns - first_ns
        drifted = np.interp(on_first_ns - at_ns[0], at_ns - at_ns[0], (offset_ns - first_ns).astype(np.float64))
        on_wall: Int64 = on_first_ns - drifted.astype(np.int64) + self._zero_ns[self._first]
        return on_wall


def export(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_file(folder / "timeline.pftrace", partial(write_perfetto, analysis))]
