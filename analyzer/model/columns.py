"""The columns of `roundtrips.parquet` and `summary.parquet`: name, type, unit, meaning (`docs/trace-format.md`).

One table for everything that must agree on them: the frames, the Parquet files, the documentation.
"""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

from ..statistics.percentiles import PERCENTILES
from .metrics import METRICS


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a frame; `unit` is empty where a value has none."""

    name: str
    dtype: type[pl.DataType]
    unit: str
    meaning: str


KEY_COLUMNS = (
    Column("run_id", pl.UInt64, "", "the run, drawn at random by its ping"),
    Column("relay_id", pl.UInt32, "", "the relay; 0 if none took part in the run"),
    Column("sequence", pl.UInt64, "", "the message's number within the run"),
)

PARAMETER_COLUMNS = (
    Column("vendor", pl.String, "", "middleware of the ping"),
    Column("backend", pl.String, "", "API that carried the messages of the ping"),
    Column("rmw", pl.String, "", "ROS 2 middleware interface of the ping; null outside ROS 2"),
    Column("bridge", pl.String, "", "none, or the bridge between the two domains"),
    Column("relay_vendor", pl.String, "", "middleware of the relay; null without its trace"),
    Column("relay_backend", pl.String, "", "API of the relay; null without its trace"),
    Column("ping_domain_id", pl.Int32, "", "DDS domain of the ping"),
    Column("relay_domain_id", pl.Int32, "", "DDS domain of the relay; null if nobody said"),
    Column("domain_mode", pl.String, "", "same or different"),
    Column("data_type", pl.String, "", "binary, string, imu or another payload's name"),
    Column("payload_bytes", pl.UInt32, "B", "application bytes of a message, the stamp not counted"),
    Column("rate_hz", pl.Float64, "Hz", "rate that the schedule asked for"),
    Column("reliability", pl.String, "", "reliable or best_effort"),
    Column("durability", pl.String, "", "volatile or transient_local"),
    Column("history", pl.String, "", "keep_last or keep_all"),
    Column("depth", pl.Int32, "", "messages kept, for keep_last"),
    Column("serialization", pl.String, "", "typed or raw"),
    Column("ping_device", pl.String, "", "device of the ping"),
    Column("relay_device", pl.String, "", "device of the relay; null without its trace"),
    Column("connectivity", pl.String, "", "loopback, wired, wireless ... as the ping was told"),
)

_PING, _RELAY = "ping's monotonic clock", "relay's monotonic clock"

MEASURED_COLUMNS = (
    Column(
        "scheduled_ns", pl.Int64, "ns", f"T0: planned send time, {_PING}; null if the run had no schedule"
    ),
    Column("publish_ns", pl.Int64, "ns", f"T1: handed to the middleware, {_PING}"),
    Column("receive_ns", pl.Int64, "ns", f"T2: reply received, {_PING}; null if lost"),
    Column("relay_in_ns", pl.Int64, "ns", f"T3: received by the relay, {_RELAY}; null if not seen there"),
    Column("relay_out_ns", pl.Int64, "ns", f"T4: reply handed over, {_RELAY}; null if not seen there"),
    Column("rtt_ns", pl.Int64, "ns", "T2 - T1; null where an input is missing"),
    Column("intermediate_ns", pl.Int64, "ns", "T4 - T3; null where an input is missing"),
    Column("latency_ns", pl.Int64, "ns", "(rtt - intermediate) // 2; null where an input is missing"),
    Column("response_ns", pl.Int64, "ns", "T2 - T0; null where an input is missing"),
    Column("outcome", pl.String, "", "completed, lost_outbound, lost_in_relay, lost_return or lost_unknown"),
    Column("duplicates", pl.UInt16, "", "extra T2 for the same message, at most 65535"),
    Column("reordered", pl.Boolean, "", "its T2 came after the T2 of a later sequence"),
    Column("outbound_ns", pl.Int64, "ns", "T1 to T3 on the ping's clock; null without all four stamps"),
    Column("return_ns", pl.Int64, "ns", "T4 to T2 on the ping's clock; rtt - intermediate - outbound"),
    Column(
        "clock_bound_ns", pl.Int64, "ns", "outbound and return are wrong by at most this, one up as one down"
    ),
)

ROUNDTRIP_COLUMNS = KEY_COLUMNS + PARAMETER_COLUMNS + MEASURED_COLUMNS

COUNT_COLUMNS = (
    Column("published", pl.UInt64, "", "messages published, times the relays that took part"),
    Column("received", pl.UInt64, "", "messages whose reply came back"),
    Column("lost_outbound", pl.UInt64, "", "lost on the way to the relay"),
    Column("lost_in_relay", pl.UInt64, "", "received but not sent by the relay"),
    Column("lost_return", pl.UInt64, "", "lost on the way back"),
    Column("lost_unknown", pl.UInt64, "", "lost; the relay's trace is missing, so nobody knows where"),
    Column("duplicates", pl.UInt64, "", "extra T2 events"),
    Column("reordered", pl.UInt64, "", "messages whose T2 came after the T2 of a later sequence"),
    Column("received_ratio", pl.Float64, "", "received / published"),
    Column(
        "achieved_rate_hz", pl.Float64, "Hz", "(messages - 1) / (last T1 - first T1), summed over the runs"
    ),
    Column(
        "transfer_rate_bytes_per_s",
        pl.Float64,
        "B/s",
        "payload bytes that reached the relay / (last T4 - first T3), summed over the runs; "
        "without relay events: received replies / (last T2 - first T2)",
    ),
)

STATISTICS = ("mean", "std", "min", *(p.name for p in PERCENTILES), "max")
"""Statistics of a metric in the summary, in column order: `<metric>_<statistic>_ns`."""

SUMMARY_COLUMNS = (
    PARAMETER_COLUMNS
    + COUNT_COLUMNS
    + tuple(
        Column(
            f"{metric}_{statistic}_ns", pl.Float64, "ns", f"{statistic} of {metric}; null if not supported"
        )
        for metric in METRICS
        for statistic in STATISTICS
    )
)

PARAMETER_NAMES = tuple(column.name for column in PARAMETER_COLUMNS)


def schema_of(columns: tuple[Column, ...]) -> dict[str, type[pl.DataType]]:
    """Column name -> polars type, in order."""
    return {column.name: column.dtype for column in columns}
