"""The frames about the wire: what a group's messages cost, by class of traffic and by number of repeats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median

import numpy as np
import polars as pl

from dds_trace.analyzer.groups.batch import Grouping
from dds_trace.analyzer.model.detail_frames import WIRE_CLASS_SCHEMA, WIRE_REPEAT_SCHEMA, WIRE_SCHEMA
from dds_trace.analyzer.model.metrics import frame_schema
from dds_trace.analyzer.pairing.rows import RowStore
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.json_fields import Json, JsonObject, number_of, object_of, objects_of
from dds_trace.tracefile.reading.trace import Trace

from .format import AGAIN_CLASSES, DISCOVERY_CLASSES, MESSAGE_ROW, Direction, rows_of_text

_KEY = ["run_id", "sequence"]
_RECORD_COLUMNS = (*_KEY, "relay_id", "direction", "first_ns", "repeats", "resent_after_ns", "waited_heartbeats")
_ROW_SCHEMA = frame_schema("run_id:u64 sequence:u64 relay_id:u32 rtt_ns:i64 latency_ns:i64")


def wire_frames(
    traces: Sequence[Trace], runs: Mapping[int, Run], grouping: Grouping, rows: RowStore
) -> dict[str, pl.DataFrame]:
    counts = {run_id: value for run_id, run in runs.items() if (value := object_of(run.extra.get("wire")))}
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
        pings = [counts[run_id] for run_id in group_runs]
        relayed = [(capture, ids <= group_runs.keys()) for capture, ids in relay_counts if ids & group_runs.keys()]
        payload_bytes = sum(
            runs[run_id].published * runs[run_id].payload_bytes * (1 + returned * relays[run_id])
            for run_id in group_runs
        )
        by_class, packets = (_by_class(pings, name) for name in ("bytes", "packets"))
        joined = _joined(group_rows, records)
        frame.append({"group": group, **_costs(pings, relayed, by_class, payload_bytes, joined)})
        total = by_class.total()
        classes += [
            (group, name, packets[name], count, count / total) for name, count in sorted(by_class.items()) if total
        ]
        repeats.append(_repeat_rows(group, joined))
    return {
        "wire": pl.DataFrame(frame, WIRE_SCHEMA),
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


def _by_class(captures: Iterable[JsonObject], unit: str) -> Counter[str]:
    counts: Counter[str] = Counter()
    for traffic in (traffic for capture in captures for traffic in objects_of(capture.get("classes"))):
        counts[str(traffic.get("name"))] += _count(traffic.get(unit))
    return counts


def _is_local(counts: JsonObject) -> bool:
    """Return whether most bytes went over the loopback interface: both captures then have the same packets."""
    bytes_by_direction: Counter[str] = Counter()
    for traffic in objects_of(counts.get("classes")):
        bytes_by_direction[str(traffic.get("direction"))] += _count(traffic.get("bytes"))
    return 2 * bytes_by_direction[Direction.LOCAL.name.lower()] > bytes_by_direction.total()


def _connections(counts: JsonObject) -> list[JsonObject]:
    return [tcp for tcp in objects_of(counts.get("tcp")) if (number_of(tcp.get("bytes_sent")) or 0) > 0]


def _costs(
    pings: Sequence[JsonObject],
    relayed: Sequence[tuple[JsonObject, bool]],
    by_class: Counter[str],
    payload_bytes: float,
    joined: pl.DataFrame,
) -> dict[str, object]:
    counted = [*pings, *(capture for capture, is_own in relayed if is_own and not _is_local(capture))]
    connections = [connection for capture in counted for connection in _connections(capture)]
    connected = [connection for capture in pings for connection in _connections(capture)]
    total, duration_s = by_class.total(), sum(number_of(capture.get("duration_s")) or 0 for capture in pings)
    again, discovery = (sum(by_class[name] for name in names) for names in (AGAIN_CLASSES, DISCOVERY_CLASSES))
    dropped = sum(_count(capture.get("kernel_drops")) for capture in (*pings, *(capture for capture, _ in relayed)))
    repeated = joined.filter(pl.col("repeats") > 0)
    return {
        "runs": len(pings),
        "shared_counts": sum(not is_own for _, is_own in relayed),
        "complete": not dropped,
        "kernel_drops": dropped,
        "total_bytes": total,
        "payload_bytes": round(payload_bytes),
        "bytes_per_payload_byte": total / payload_bytes if payload_bytes else None,
        "again_bytes_share": again / total if total else None,
        "messages": joined.height,
        "again_messages": repeated.height,
        "carried_twice": joined.filter(pl.col("interfaces") > 1).height,
        "resent_after_p50_ns": repeated["resent_after_ns"].median(),
        "waited_heartbeats_p50": repeated["waited_heartbeats"].median(),
        "match_p50_ns": _median(ns for capture in pings if (ns := number_of(capture.get("match_ns")) or 0) > 0),
        "tcp_rtt_p50_ns": _median((number_of(tcp.get("rtt_us")) or 0) * 1000 for tcp in connected),
        "tcp_congestion_window_p50": _median(number_of(tcp.get("congestion_window")) or 0 for tcp in connected),
        "tcp_retransmitted_segments": sum(_count(tcp.get("retransmitted_segments")) for tcp in connections),
        "discovery_share": discovery / total if total else None,
        "discovery_bytes_per_minute": discovery * 60 / duration_s if duration_s else None,
        **{name: sum(_count(capture.get(name)) for capture in counted) for name in ("requests", "tcp_again_bytes")},
        **{
            name: sum(_count(object_of(capture.get("ip")).get(name)) for capture in counted)
            for name in ("reassembly_failed", "udp_receive_buffer_full")
        },
    }


def _median(values: Iterable[float]) -> float | None:
    numbers = list(values)
    return median(numbers) if numbers else None


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
