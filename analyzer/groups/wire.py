"""The frames about the wire: what a group's messages cost, by class of traffic and by number of repeats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np
import polars as pl

from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.json_fields import Json, JsonObject, number_of, object_of, objects_of
from dds_trace.tracefile.format.wire import AGAIN_CLASSES, DISCOVERY_CLASSES, MESSAGE_ROW, Direction, rows_of_text
from dds_trace.tracefile.reading.trace import Trace

from ..model.metrics import frame_schema
from ..pairing.rows import RowStore
from .batch import Grouping

WIRE_SCHEMA = frame_schema(
    "group:u32 runs:u32 complete:bool kernel_drops:u64 total_bytes:u64 payload_bytes:u64 "
    "bytes_per_payload_byte:f64 again_bytes_share:f64 messages:u64 again_messages:u64 requests:u64 "
    "resent_after_p50_ns:f64 waited_heartbeats_p50:f64 match_p50_ns:f64 discovery_share:f64 "
    "discovery_bytes_per_minute:f64 reassembly_failed:u64 udp_receive_buffer_full:u64 tcp_again_bytes:u64 "
    "shared_counts:u32 tcp_retransmitted_segments:u64 tcp_rtt_p50_ns:f64 tcp_congestion_window_p50:f64 carried_twice:u64"
)
"""A row per group with counts. `complete`: no capture dropped a packet; `total_bytes` on the ping's interfaces, both ways, from
Ethernet headers on; `payload_bytes` of messages and replies, warm-up included; `again_*`: sent again on either way;
`waited_heartbeats_p50` of their writer; `match_p50_ns` from a participant's first announcement to the first echo; `discovery_*`
SPDP, SEDP and liveliness; `carried_twice` messages or replies that left on more than one interface; `tcp_*` from `TCP_INFO` of the ping's connections, null without TCP; `shared_counts` of a relay's
capture belong to other groups' runs, too: only their `kernel_drops` count."""

WIRE_CLASS_SCHEMA = frame_schema("group:u32 wire_class:str packets:u64 bytes:u64 share:f64")
"""A row per group and class of traffic (`docs/reference/wire.md`) on the ping's interfaces, both ways."""

WIRE_REPEAT_SCHEMA = frame_schema(
    "group:u32 repeats:u32 messages:u64 returned:u64 rtt_p50_ns:f64 rtt_max_ns:f64 latency_p50_ns:f64 "
    "latency_max_ns:f64"
)
"""A row per group and number of repeats of both ways together, warm-up left out: `returned` came back in these times."""

WIRE_FRAMES = {"wire": WIRE_SCHEMA, "wire_classes": WIRE_CLASS_SCHEMA, "wire_repeats": WIRE_REPEAT_SCHEMA}

_KEY = ["run_id", "sequence"]
_RECORD_COLUMNS = (*_KEY, "relay_id", "direction", "first_ns", "repeats", "resent_after_ns", "waited_heartbeats")
_ROW_SCHEMA = frame_schema("run_id:u64 sequence:u64 relay_id:u32 rtt_ns:i64 latency_ns:i64")


@dataclass(slots=True)
class _Sums:
    runs: int = 0
    duration_s: float = 0.0
    payload_bytes: float = 0.0
    shared_counts: int = 0
    matches_ns: list[float] = field(default_factory=list)
    tcp_rtts_ns: list[float] = field(default_factory=list)
    tcp_windows: list[float] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)
    bytes: Counter[str] = field(default_factory=Counter)
    packets: Counter[str] = field(default_factory=Counter)


def wire_frames(
    traces: Sequence[Trace], runs: Mapping[int, Run], grouping: Grouping, rows: RowStore
) -> dict[str, pl.DataFrame]:
    counts = {run_id: value for run_id, run in runs.items() if (value := object_of(run.extra.get("wire")))}
    if not counts:
        return {name: pl.DataFrame(schema=schema) for name, schema in WIRE_FRAMES.items()}
    relay_counts, records = _relay_counts(traces), _records(traces)
    frame, classes, repeats = [], [], []
    for group, members in enumerate(grouping.members()):
        exchanges = [grouping.exchanges[member] for member in members]
        group_runs = dict.fromkeys(e.run.run_id for e in exchanges if e.run.run_id in counts)
        if not group_runs:
            continue
        group_rows = (
            rows.frame(rows.groups[group], list(_ROW_SCHEMA)) if rows.has_rows else pl.DataFrame(schema=_ROW_SCHEMA)
        )
        returned = 1.0 if group_rows.is_empty() else group_rows["rtt_ns"].count() / group_rows.height
        relays = Counter(e.run.run_id for e in exchanges)
        sums = _Sums()
        for run_id in group_runs:
            run = runs[run_id]
            _add_ping(sums, counts[run_id])
            sums.payload_bytes += run.published * run.payload_bytes * (1 + returned * relays[run_id])
        for capture, run_ids in relay_counts:
            if run_ids & group_runs.keys():
                _add_relay(sums, capture, is_shared=not run_ids <= group_runs.keys())
        joined = _joined(group_rows, records)
        frame.append(_row(group, sums, joined))
        total = sum(sums.bytes.values())
        classes += [
            (group, name, sums.packets[name], count, count / total)
            for name, count in sorted(sums.bytes.items())
            if total
        ]
        repeats.append(_repeat_rows(group, joined))
    return {
        "wire": pl.DataFrame(frame, WIRE_SCHEMA, orient="row"),
        "wire_classes": pl.DataFrame(classes, WIRE_CLASS_SCHEMA, orient="row"),
        "wire_repeats": pl.concat([pl.DataFrame(schema=WIRE_REPEAT_SCHEMA), *repeats]),
    }


def _relay_counts(traces: Iterable[Trace]) -> list[tuple[JsonObject, frozenset[int]]]:
    counts: dict[tuple[Json, Json], tuple[JsonObject, frozenset[int]]] = {}
    for trace in traces:
        for text in trace.wire:
            capture, run_ids = object_of(text.get("counts")), text.get("run_ids")
            if capture and isinstance(run_ids, list):
                served = frozenset(int(str(run_id), 16) for run_id in run_ids)
                counts[text.get("session_id"), capture.get("begin_ns")] = capture, served
    return list(counts.values())


def _records(traces: Iterable[Trace]) -> pl.DataFrame:
    parts = [rows_of_text(text) for trace in traces for text in trace.wire]
    packed = np.concatenate([np.empty(0, MESSAGE_ROW), *parts])
    is_sent = packed["direction"] != Direction.RECEIVED
    capture, sent = np.repeat(np.arange(len(parts)), list(map(len, parts)))[is_sent], packed[is_sent]
    # On the loopback interface both captures have the message: one record is enough. A capture has a record for each other
    # interface on which a message left; files may be copies.
    is_sent = pl.col("direction") == Direction.SENT.value
    return (
        pl.DataFrame({name: np.ascontiguousarray(sent[name]) for name in _RECORD_COLUMNS})
        .with_columns(capture=capture)
        .group_by(*_KEY, "relay_id", "capture")
        .agg(
            pl.col("repeats", "resent_after_ns", "waited_heartbeats").max(),
            interfaces=pl.col("first_ns").filter(is_sent).n_unique(),
        )
        .group_by(*_KEY, "relay_id")
        .agg(pl.exclude("capture").max())
    )


def _joined(rows: pl.DataFrame, records: pl.DataFrame) -> pl.DataFrame:
    out = records.filter(relay_id=0).drop("relay_id")
    joined = rows.join(out, on=_KEY).join(records, on=[*_KEY, "relay_id"], how="left", suffix="_back")
    return joined.select(
        "rtt_ns",
        "latency_ns",
        repeats=pl.col("repeats").cast(pl.UInt32) + pl.col("repeats_back").fill_null(0),
        resent_after_ns=pl.max_horizontal("resent_after_ns", "resent_after_ns_back"),
        waited_heartbeats=pl.max_horizontal("waited_heartbeats", "waited_heartbeats_back"),
        interfaces=pl.max_horizontal("interfaces", "interfaces_back"),
    )


def _add_ping(sums: _Sums, counts: JsonObject) -> None:
    sums.runs += 1
    sums.duration_s += number_of(counts.get("duration_s")) or 0
    if (match_ns := (number_of(counts.get("match_ns")) or 0)) > 0:
        sums.matches_ns.append(match_ns)
    for connection in _connections(counts):
        sums.tcp_rtts_ns.append((number_of(connection.get("rtt_us")) or 0) * 1000)
        sums.tcp_windows.append(number_of(connection.get("congestion_window")) or 0)
    for traffic in objects_of(counts.get("classes")):
        name = str(traffic.get("name"))
        sums.bytes[name] += _count(traffic.get("bytes"))
        sums.packets[name] += _count(traffic.get("packets"))
    _add_counters(sums, counts)


def _add_relay(sums: _Sums, counts: JsonObject, *, is_shared: bool) -> None:
    if is_shared:
        sums.shared_counts += 1
    if is_shared or _is_local(counts):
        sums.counters["kernel_drops"] += _count(counts.get("kernel_drops"))
    else:
        _add_counters(sums, counts)


def _is_local(counts: JsonObject) -> bool:
    """Return whether most bytes went over the loopback interface: both captures then have the same packets."""
    bytes_by_direction: Counter[str] = Counter()
    for traffic in objects_of(counts.get("classes")):
        bytes_by_direction[str(traffic.get("direction"))] += _count(traffic.get("bytes"))
    return 2 * bytes_by_direction[Direction.LOCAL.name.lower()] > bytes_by_direction.total()


def _add_counters(sums: _Sums, counts: JsonObject) -> None:
    kernel = object_of(counts.get("ip"))
    for name in ("kernel_drops", "requests", "tcp_again_bytes"):
        sums.counters[name] += _count(counts.get(name))
    for name in ("reassembly_failed", "udp_receive_buffer_full"):
        sums.counters[name] += _count(kernel.get(name))
    sums.counters["tcp_retransmitted_segments"] += sum(
        _count(connection.get("retransmitted_segments")) for connection in _connections(counts)
    )


def _connections(counts: JsonObject) -> list[JsonObject]:
    return [tcp for tcp in objects_of(counts.get("tcp")) if (number_of(tcp.get("bytes_sent")) or 0) > 0]


def _row(group: int, sums: _Sums, joined: pl.DataFrame) -> tuple[object, ...]:
    total = sum(sums.bytes.values())
    again = sum(sums.bytes[name] for name in AGAIN_CLASSES)
    discovery = sum(sums.bytes[name] for name in DISCOVERY_CLASSES)
    repeated = joined.filter(pl.col("repeats") > 0)
    values: dict[str, object] = {
        "group": group,
        "runs": sums.runs,
        "shared_counts": sums.shared_counts,
        "complete": not sums.counters["kernel_drops"],
        "total_bytes": total,
        "payload_bytes": round(sums.payload_bytes),
        "bytes_per_payload_byte": total / sums.payload_bytes if sums.payload_bytes else None,
        "again_bytes_share": again / total if total else None,
        "messages": joined.height,
        "again_messages": repeated.height,
        "carried_twice": joined.filter(pl.col("interfaces") > 1).height,
        "resent_after_p50_ns": repeated["resent_after_ns"].median(),
        "waited_heartbeats_p50": repeated["waited_heartbeats"].median(),
        "match_p50_ns": median(sums.matches_ns) if sums.matches_ns else None,
        "tcp_rtt_p50_ns": median(sums.tcp_rtts_ns) if sums.tcp_rtts_ns else None,
        "tcp_congestion_window_p50": median(sums.tcp_windows) if sums.tcp_windows else None,
        "discovery_share": discovery / total if total else None,
        "discovery_bytes_per_minute": discovery * 60 / sums.duration_s if sums.duration_s else None,
        **{
            name: sums.counters[name]
            for name in (
                "kernel_drops",
                "requests",
                "reassembly_failed",
                "udp_receive_buffer_full",
                "tcp_again_bytes",
                "tcp_retransmitted_segments",
            )
        },
    }
    return tuple(values[name] for name in WIRE_SCHEMA)


def _repeat_rows(group: int, joined: pl.DataFrame) -> pl.DataFrame:
    return (
        joined.group_by("repeats")
        .agg(
            pl.len().alias("messages"),
            pl.col("rtt_ns").count().alias("returned"),
            pl.col("rtt_ns").median().alias("rtt_p50_ns"),
            pl.col("rtt_ns").max().alias("rtt_max_ns"),
            pl.col("latency_ns").median().alias("latency_p50_ns"),
            pl.col("latency_ns").max().alias("latency_max_ns"),
        )
        .with_columns(pl.lit(group).alias("group"))
        .select(pl.col(name).cast(kind) for name, kind in WIRE_REPEAT_SCHEMA.items())
        .sort("repeats")
    )


def _count(value: Json) -> int:
    return int(number_of(value) or 0)
