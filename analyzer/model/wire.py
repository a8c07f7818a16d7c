"""Columns of the frames of `Details` about the wire, which are empty without recordings of `--wire`."""

from __future__ import annotations

import polars as pl

WIRE_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "runs": pl.UInt32,
    "complete": pl.Boolean,
    "kernel_drops": pl.UInt64,
    "total_bytes": pl.UInt64,
    "payload_bytes": pl.UInt64,
    "bytes_per_payload_byte": pl.Float64,
    "again_bytes_share": pl.Float64,
    "messages": pl.UInt64,
    "again_messages": pl.UInt64,
    "requests": pl.UInt64,
    "resent_after_p50_ns": pl.Float64,
    "waited_heartbeats_p50": pl.Float64,
    "match_p50_ns": pl.Float64,
    "discovery_share": pl.Float64,
    "discovery_bytes_per_minute": pl.Float64,
    "reassembly_failed": pl.UInt64,
    "udp_receive_buffer_full": pl.UInt64,
    "tcp_again_bytes": pl.UInt64,
    "shared_counts": pl.UInt32,
    "tcp_retransmitted_segments": pl.UInt64,
    "tcp_rtt_p50_ns": pl.Float64,
    "tcp_congestion_window_p50": pl.Float64,
}
"""A row per group with counts. `runs` with counts; `complete`: no capture dropped a packet (`kernel_drops`); `total_bytes` on
the ping's interfaces, both ways, Ethernet headers included; `payload_bytes` of all messages and replies, warm-up included;
`again_bytes_share` of bytes that were sent again; `messages` with a record, `again_messages` of them sent again on either
way, half of these after `resent_after_p50_ns` and `waited_heartbeats_p50` heartbeats of their writer; `requests` to send
again; `match_p50_ns` from a participant's first announcement to the first echo, median of the runs; `discovery_*` SPDP, SEDP
and liveliness; `reassembly_failed` and `udp_receive_buffer_full` datagrams of both devices; `tcp_again_bytes` TCP payload
sent again in `tcp_retransmitted_segments` (`TCP_INFO`), medians of smoothed round-trip times and congestion windows
(segments) of the ping's connections at the end of its runs, null without TCP; `shared_counts` of a relay's capture that belong
to other groups' runs as well: only their `kernel_drops` count here."""

WIRE_CLASS_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "wire_class": pl.String,
    "packets": pl.UInt64,
    "bytes": pl.UInt64,
    "share": pl.Float64,
}
"""A row per group and class of traffic (`docs/reference/wire.md`) on the ping's interfaces, both ways; `share` of the group's bytes."""

WIRE_REPEAT_SCHEMA: dict[str, type[pl.DataType]] = {
    "group": pl.UInt32,
    "repeats": pl.UInt32,
    "messages": pl.UInt64,
    "returned": pl.UInt64,
    "rtt_p50_ns": pl.Float64,
    "rtt_max_ns": pl.Float64,
    "latency_p50_ns": pl.Float64,
    "latency_max_ns": pl.Float64,
}
"""A row per group and number of repeats of both ways together: `messages` that were sent again so often, without warm-up,
`returned` of them came back, and their times; null where none has such a time."""

WIRE_FRAMES = {
    "wire": WIRE_SCHEMA,
    "wire_classes": WIRE_CLASS_SCHEMA,
    "wire_repeats": WIRE_REPEAT_SCHEMA,
}
"""Name of each frame in `Details` -> its columns."""
