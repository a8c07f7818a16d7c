"""The columns of `roundtrips.parquet` and `summary.parquet`; frames, files and docs follow."""

from __future__ import annotations

import polars as pl

from ..statistics.percentiles import STATISTICS
from .metrics import METRICS, Column, Metric
from .parameters import PARAMETER_COLUMNS

KEY_COLUMNS = (
    Column("run_id", pl.UInt64, "", "the run, drawn at random by its ping"),
    Column("relay_id", pl.UInt32, "", "the relay; 0 if none took part in the run"),
    Column("sequence", pl.UInt64, "", "the message's number within the run"),
)

_PING, _RELAY = "ping's monotonic clock", "relay's monotonic clock"

MEASURED_COLUMNS = (
    Column("scheduled_ns", pl.Int64, "ns", f"T0: planned send time, {_PING}; null if the run had no schedule"),
    Column("publish_ns", pl.Int64, "ns", f"T1: handed to the middleware, {_PING}"),
    Column("receive_ns", pl.Int64, "ns", f"T2: reply received, {_PING}; null if lost"),
    Column("relay_in_ns", pl.Int64, "ns", f"T3: received by the relay, {_RELAY}; null if not seen there"),
    Column("relay_out_ns", pl.Int64, "ns", f"T4: reply handed over, {_RELAY}; null if not seen there"),
    *(metric.column for metric in METRICS.values()),
    Column("outcome", pl.String, "", "completed, lost_outbound, lost_in_relay, lost_return or lost_unknown"),
    Column("duplicates", pl.UInt16, "", "extra T2 for the same message, at most 65535"),
    Column("reordered", pl.Boolean, "", "its T2 came after the T2 of a later sequence"),
    Column("outbound_ns", pl.Int64, "ns", "T1 to T3 on the ping's clock; null without all four stamps"),
    Column("return_ns", pl.Int64, "ns", "T4 to T2 on the ping's clock; rtt - intermediate - outbound"),
    Column("clock_bound_ns", pl.Int64, "ns", "outbound and return are wrong by at most this, one up as one down"),
)

_UTC = pl.Datetime("ns", "UTC")
_BY_ANCHOR = "on the wall clock as the session read it at its start; as wrong as that was, null where unknown"

UTC_COLUMNS = (
    Column("publish_utc", _UTC, "UTC", f"T1 (publish_ns) {_BY_ANCHOR}; the ping's device"),
    Column("relay_in_utc", _UTC, "UTC", f"T3 (relay_in_ns) {_BY_ANCHOR}; the relay's device"),
)
"""To find a message in other logs, one for each clock."""

_FIRST_PARAMETERS = 20
"""Of the first version of the contract; later columns are appended."""

_PARAMETERS_BEFORE_RUNS = 21
"""When the summary got `RUN_COLUMNS` and `OWN_COLUMNS`, the rows `UTC_COLUMNS`."""

ROUNDTRIP_COLUMNS = (
    KEY_COLUMNS
    + PARAMETER_COLUMNS[:_FIRST_PARAMETERS]
    + MEASURED_COLUMNS
    + PARAMETER_COLUMNS[_FIRST_PARAMETERS:_PARAMETERS_BEFORE_RUNS]
    + UTC_COLUMNS
    + PARAMETER_COLUMNS[_PARAMETERS_BEFORE_RUNS:]
)

PARQUET_ENCODINGS = {
    column.name: "DELTA_BINARY_PACKED"
    for column in ROUNDTRIP_COLUMNS
    if column.unit in ("ns", "UTC") or column.name == "sequence"
}
"""Of `roundtrips.parquet`: times ascend by steps or stay within a range. Other columns are dictionaries."""

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
    Column("achieved_rate_hz", pl.Float64, "Hz", "(messages - 1) / (last T1 - first T1), summed over the runs"),
    Column(
        "transfer_rate_bytes_per_s",
        pl.Float64,
        "B/s",
        "payload bytes that reached the relay / (last T4 or T3 - first T3), summed over the runs; "
        "without relay events: received replies / (last T2 - first T2)",
    ),
)

RUN_COLUMNS = (
    Column("runs", pl.UInt64, "", "runs that are summarized"),
    Column("planned", pl.UInt64, "", "messages that the runs planned, times the relays that took part"),
    Column(
        "unsent",
        pl.UInt64,
        "",
        "planned messages whose T0 had passed when the run ended and that were never published, times the relays",
    ),
    Column(
        "environment",
        pl.String,
        "",
        "digest of what both sides ran in (kernel, governor, versions ...); several joined by +",
    ),
)

OWN_COLUMNS = (
    Column(
        "own_cost_ns",
        pl.Float64,
        "ns",
        "what the nodes of ping and relay take of a round trip themselves: both sessions' client_library_floor and two "
        "events of the relay's recorder_cost, median over the runs; null where a side measured none",
    ),
    Column("own_share", pl.Float64, "", "own_cost_ns / rtt_p50_ns"),
)

SENT_COLUMNS = (
    Column(
        "sent",
        pl.UInt64,
        "",
        "messages published, with those that no reply was requested for (`ping_share`), times the relays",
    ),
    Column(
        "reached", pl.UInt64, "", "of these, messages that reached the relay; without its trace, those with a reply"
    ),
    Column("reached_rate_hz", pl.Float64, "Hz", "reached / (last T4 or T3 - first T3), summed over the runs"),
)


def _meaning_of(metric: Metric, statistic: str) -> str:
    is_tail = statistic == "max" or statistic.startswith("p9")
    warning = f"; {metric.tail}" if metric.tail and is_tail else ""
    return f"{statistic} of {metric.name}; null if not supported{warning}"


SUMMARY_COLUMNS = (
    PARAMETER_COLUMNS[:_FIRST_PARAMETERS]
    + COUNT_COLUMNS
    + tuple(
        Column(f"{name}_{statistic.name}_ns", pl.Float64, "ns", _meaning_of(metric, statistic.name))
        for name, metric in METRICS.items()
        for statistic in STATISTICS
    )
    + PARAMETER_COLUMNS[_FIRST_PARAMETERS:_PARAMETERS_BEFORE_RUNS]
    + RUN_COLUMNS
    + OWN_COLUMNS
    + SENT_COLUMNS
    + PARAMETER_COLUMNS[_PARAMETERS_BEFORE_RUNS:]
)
