"""The frame `host_samples`: load of every recording device over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import polars as pl

from dds_trace.tracefile.format.descriptions import Session
from dds_trace.tracefile.format.json_fields import number_of, object_of
from dds_trace.tracefile.reading.trace import Trace

from ..model.metrics import frame_schema

MOST_OF_SESSION = 2000
"""Most samples of a session; of more, those with the busiest processor of each stretch."""

_OURS = ("self", "wire")
"""Sampled processes of the recorder; all others are a bridge's."""

HOST_SAMPLE_SCHEMA = frame_schema(
    "session_id:u64 role:str device:str wall_ns:i64 monotonic_ns:i64 cpu_percent:f64 "
    "cpu_busiest_percent:f64 cpu_mhz:f64 temperature_c:f64 memory_used_bytes:f64 "
    "memory_available_bytes:f64 load_1min:f64 node_cpu_percent:f64 node_memory_bytes:f64 "
    "bridge_cpu_percent:f64 wifi_signal_dbm:f64 udp_receive_errors:f64 sampling_cpu_ns:f64 "
    "monotonic_raw_ns:i64 cpu_free_processors:f64 cpu_steal_ns:f64 cpu_pressure_us:f64 "
    "link_rate_mbit_s:f64 link_delay_ms:f64 link_loss_percent:f64"
)


def host_sample_frame(traces: Sequence[Trace]) -> pl.DataFrame:
    """Return one row per sample, by session, then by time: columns of `HOST_SAMPLE_SCHEMA`, null where unknown.

    `wall_ns` is since 1970; `node_*` the recording process and `bridge_cpu_percent` the bridge's, of one processor each;
    `wifi_signal_dbm` the weakest interface; `udp_receive_errors` drops for lack of buffer since the first sample;
    `sampling_cpu_ns` the cost of the previous sample; `cpu_steal_ns` and `cpu_pressure_us` time since boot that a hypervisor
    gave to others and in which some task waited for a processor; `link_*` what an emulated link did from then on.
    """
    rows: dict[tuple[int, float], dict[str, object]] = {}
    for trace in traces:
        for sample in trace.host_samples:
            session = _session_at(trace.sessions, number_of(sample.get("log_time_ns")))
            row = _row(sample)
            if session is not None and row["monotonic_ns"] is None and row["wall_ns"] is not None:
                row["monotonic_ns"] = int(session.monotonic_anchor_ns + row["wall_ns"] - session.wall_anchor_ns)
            if session is not None and row["wall_ns"] is not None:
                described = {"session_id": session.session_id, "role": session.role, "device": session.device}
                rows.setdefault((session.session_id, row["wall_ns"]), described | row)  # files may be copies
    frame = pl.DataFrame(list(rows.values()), schema=HOST_SAMPLE_SCHEMA).sort("session_id", "wall_ns")
    errors = pl.col("udp_receive_errors")
    index, count = pl.int_range(pl.len()), pl.len()
    stretch = (index * (MOST_OF_SESSION // 2) // count).over("session_id")
    return (
        frame.with_columns(
            (errors - errors.drop_nulls().first()).over("session_id").alias("udp_receive_errors"),
            stretch=pl.when(count.over("session_id") > MOST_OF_SESSION)
            .then(stretch)
            .otherwise(index.over("session_id")),
        )
        .filter(
            pl.col("link_delay_ms").is_not_null()
            | (
                pl.col("cpu_busiest_percent")
                .fill_null(0)
                .rank("ordinal", descending=True)
                .over("session_id", "stretch")
                == 1
            )
        )
        .drop("stretch")
    )


def node_percent(samples: pl.DataFrame, sessions: Iterable[Session], start_ns: int, end_ns: int) -> float | None:
    """Return the mean load of recording processes between two times of the wall clock, percent of one processor; None without samples."""
    ids = [session.session_id for session in sessions]
    during = samples.filter(pl.col("wall_ns").is_between(start_ns, end_ns) & pl.col("session_id").is_in(ids))
    return number_of(during["node_cpu_percent"].mean())


def _session_at(sessions: Sequence[Session], wall_ns: float | None) -> Session | None:
    if wall_ns is None:
        return None
    started = [session for session in sessions if session.wall_anchor_ns <= wall_ns] or list(sessions)[:1]
    return max(started, key=lambda session: session.wall_anchor_ns, default=None)


def _row(sample: Mapping[str, object]) -> dict[str, float | None]:
    host, processes = object_of(sample.get("host")), object_of(sample.get("processes"))
    node, link = object_of(processes.get("self")), object_of(sample.get("link_now"))
    processors = host.get("cpu_percent_each")
    busy = _numbers(processors if isinstance(processors, list) else [])
    wall_ns, monotonic_ns = number_of(sample.get("log_time_ns")), number_of(sample.get("monotonic_ns"))
    raw_ns = number_of(sample.get("monotonic_raw_ns"))
    bridges = [object_of(usage).get("cpu_percent") for name, usage in processes.items() if name not in _OURS]
    return {
        "wall_ns": None if wall_ns is None else int(wall_ns),
        "monotonic_ns": None if monotonic_ns is None else int(monotonic_ns),
        **{
            name: number_of(host.get(name))
            for name in (
                "cpu_percent",
                "cpu_mhz",
                "temperature_c",
                "memory_used_bytes",
                "memory_available_bytes",
                "load_1min",
            )
        },
        "cpu_busiest_percent": max(busy, default=None),
        "node_cpu_percent": number_of(node.get("cpu_percent")),
        "node_memory_bytes": number_of(node.get("memory_bytes")),
        "bridge_cpu_percent": sum(_numbers(bridges)) if _numbers(bridges) else None,
        "wifi_signal_dbm": min(
            _numbers(object_of(w).get("signal_dbm") for w in object_of(sample.get("wifi")).values()), default=None
        ),
        "udp_receive_errors": number_of(object_of(sample.get("udp")).get("RcvbufErrors")),
        "sampling_cpu_ns": number_of(sample.get("sampling_cpu_ns")),
        "monotonic_raw_ns": None if raw_ns is None else int(raw_ns),
        "cpu_steal_ns": number_of(host.get("steal_ns")),
        "cpu_pressure_us": number_of(object_of(host.get("pressure_us")).get("cpu")),
        **{f"link_{name}": number_of(link.get(name)) for name in ("rate_mbit_s", "delay_ms", "loss_percent")},
        "cpu_free_processors": sum(100 - percent for percent in busy) / 100 if busy else None,
    }


def _numbers(values: Iterable[object]) -> list[float]:
    return [number for value in values if (number := number_of(value)) is not None]
