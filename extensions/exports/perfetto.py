"""One timeline of all devices for https://ui.perfetto.dev: a track for each, on the wall clock of the device that pinged first."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.clocks.boots import boot_id_of, ping_wall_offsets, session_boots, session_of_run
from dds_trace.analyzer.clocks.lines import Int64
from dds_trace.analyzer.exports.kinds import write_file
from dds_trace.analyzer.model.runs import tap_run_id
from dds_trace.base.printable import printable

MOST_SLICES = 100_000
"""More messages are thinned evenly."""

_SEQUENCE = 1


class Slice(NamedTuple):
    """A stretch of time on a device; an arrow joins the two slices of a `message`. `row`: run and relay in hex, sequence."""

    device: str
    lane: str
    name: str
    begin_ns: int
    end_ns: int
    message: int
    row: str = ""


def write_perfetto(analysis: Analysis, path: Path) -> None:
    write_slices(timeline_slices(analysis), path)


def write_slices(slices: Iterable[Slice], path: Path) -> None:
    """Write a timeline; a `ModuleNotFoundError` without the extra."""
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
                    if event.row:
                        packet.track_event.debug_annotations.add(name="row", string_value=event.row)
                builder.write_packet(packet)


def timeline_slices(analysis: Analysis) -> Iterator[Slice]:
    clock, flows = _Reference(analysis), count(1)
    yield from _roundtrips(analysis, clock, flows)
    yield from _topics(analysis, clock, flows)


def _roundtrips(analysis: Analysis, clock: _Reference, flows: Iterator[int]) -> Iterator[Slice]:
    names = ["run_id", "relay_id", "sequence", "vendor", "data_type", "payload_bytes", "ping_device", "relay_device"]
    times = ["publish_ns", "publish_utc", "receive_ns", "outbound_ns", "return_ns"]
    rows = _thinned(analysis.scan_roundtrips().filter(outcome="completed").select(*names, *times).collect())
    pings = {run.run_id: session_of_run(run) for run in analysis.runs}
    for part in rows.partition_by("run_id", maintain_order=True):
        begins_ns = clock.wall_ns(pings.get(part["run_id"][0], -1), part["publish_ns"].to_numpy())
        if begins_ns is None:  # a run that names no session
            begins_ns = part["publish_utc"].to_physical().fill_null(part["publish_ns"]).to_numpy()
        for begin_ns, row in zip(begins_ns.tolist(), part.iter_rows(named=True), strict=True):
            kind = f"{row['data_type']} {row['payload_bytes']} B"
            track, name = f"{row['vendor']} {kind}", f"{kind} {row['sequence']}"
            message = next(flows), f"{row['run_id']:016x} {row['relay_id']:08x} {row['sequence']}"
            end_ns = begin_ns + row["receive_ns"] - row["publish_ns"]
            yield Slice(row["ping_device"], track, name, begin_ns, end_ns, *message)
            if row["relay_device"] is not None and row["outbound_ns"] is not None:
                there_ns = begin_ns + row["outbound_ns"], end_ns - row["return_ns"]
                yield Slice(row["relay_device"], track, name, *there_ns, *message)


def _topics(analysis: Analysis, clock: _Reference, flows: Iterator[int]) -> Iterator[Slice]:
    names = ["run_id", "sequence", "data_type", "ping_device", "relay_device"]
    times = ["relay_in_ns", "one_way_ns", "stamp_to_publish_ns"]
    rows = _thinned(analysis.topic_messages.select(*names, *times).filter(pl.col("one_way_ns").is_not_null()))
    taps = [session.session_id for session in analysis.sessions if session.role == "tap"]
    for part in rows.partition_by("run_id", maintain_order=True):
        run_id, topic, sender = part.select("run_id", "data_type", "ping_device").row(0)
        tap = next(session_id for session_id in taps if tap_run_id(topic, sender, session_id) == run_id)
        instants_ns = clock.wall_ns(tap, part["relay_in_ns"].to_numpy())
        assert instants_ns is not None
        for taken_ns, row in zip(instants_ns.tolist(), part.iter_rows(named=True), strict=True):
            publish_ns, name = taken_ns - row["one_way_ns"], f"{topic} {row['sequence']}"
            message = next(flows), f"{run_id:016x} {0:08x} {row['sequence']}"
            if (row["stamp_to_publish_ns"] or 0) > 0:
                stamped_ns = publish_ns - row["stamp_to_publish_ns"]
                yield Slice(sender, topic, f"{name} stamp", stamped_ns, publish_ns, *message)
            yield Slice(row["relay_device"], topic, f"{name} one way", publish_ns, taken_ns, *message)


def _thinned(rows: pl.DataFrame) -> pl.DataFrame:
    return rows.gather_every(-(-len(rows) // MOST_SLICES)) if len(rows) else rows


class _Reference:
    """The wall clock on which the instants of all devices and boots are expressed."""

    def __init__(self, analysis: Analysis) -> None:
        boots = session_boots(analysis.sessions)
        self._sessions = {
            session.session_id: (session, (session.device, boots[session.session_id])) for session in analysis.sessions
        }
        relays = {
            (session.relay_id, session.device, boot_id_of(session)): boot for session, boot in self._sessions.values()
        }
        wall_ns = ping_wall_offsets(analysis.sessions, analysis.runs)
        by_run = pl.DataFrame(
            {"run_id": list(wall_ns), "zero_ns": list(wall_ns.values())}, {"run_id": pl.UInt64, "zero_ns": pl.Int64}
        )
        on_relay, on_wall = pl.col("at_ns") + pl.col("offset_ns"), pl.col("at_ns") + pl.col("zero_ns")
        knots = (
            analysis.details.clock_knots.join(by_run, on="run_id")
            .select("ping_device", "relay_id", "relay_device", "relay_boot", relay_ns=on_relay, wall_ns=on_wall)
            .sort("wall_ns")
        )
        self._first = knots["ping_device"][0] if len(knots) else ""
        of_relays = knots.filter(ping_device=self._first).partition_by(
            "relay_id", "relay_device", "relay_boot", as_dict=True, maintain_order=True
        )
        self._knots: dict[tuple[str, int], list[pl.DataFrame]] = defaultdict(list)
        for relay, part in of_relays.items():
            if relay in relays:
                self._knots[relays[relay]].append(part.select("relay_ns", "wall_ns"))

    def wall_ns(self, session_id: int, monotonic_ns: Int64) -> Int64 | None:
        """Return instants of a session's monotonic clock; None without the session."""
        session, boot = self._sessions.get(session_id, (None, ("", 0)))
        if session is None:
            return None
        if session.device == self._first or boot not in self._knots:
            return monotonic_ns + session.wall_ns(0)
        knots = pl.concat(self._knots[boot]).sort("relay_ns")
        at_ns, shift_ns = knots["relay_ns"].to_numpy(), (knots["wall_ns"] - knots["relay_ns"]).to_numpy()
        drift_ns = np.interp(monotonic_ns - at_ns[0], at_ns - at_ns[0], (shift_ns - shift_ns[0]).astype(np.float64))
        on_wall: Int64 = monotonic_ns + shift_ns[0] + drift_ns.astype(np.int64)
        return on_wall


def export(analysis: Analysis, folder: Path) -> list[Path]:
    return [write_file(folder / "timeline.pftrace", partial(write_perfetto, analysis))]
