"""Columns of frames that extensions make, in which an analysis that has nothing of them is empty."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import polars as pl

from .columns import ROUNDTRIP_COLUMNS
from .metrics import TOPIC_METRICS, frame_schema, schema_of
from .parameters import BRIDGE_MATCH_COLUMNS, PARAMETER_COLUMNS

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

RECOVERY_SCHEMA = frame_schema(
    "group:u32 run_id:u64 by:str began_ns:i64 ended_ns:i64 outage_ns:i64 limit_ns:i64 never:bool out_ns:i64 back_ns:i64 "
    "lost_within:u64 replayed:u64 lost_after:u64 reordered:u64 duplicates:u64"
)

COMPARISON_SCHEMA = frame_schema(
    "metric:str statistic:str base_messages:u64 new_messages:u64 base_ns:f64 new_ns:f64 new_low_ns:f64 new_high_ns:f64 "
    "difference_ns:f64 difference_low_ns:f64 difference_high_ns:f64 ratio:f64 ratio_low:f64 ratio_high:f64 superiority:f64 "
    "cliffs_delta:f64 verdict:str base_received_ratio:f64 new_received_ratio:f64 base_survivors_ns:f64 new_survivors_ns:f64 "
    "base_low_ns:f64 base_high_ns:f64 base_runs:u64 new_runs:u64 base_episodes:u64 new_episodes:u64 basis:str pairs:u64 "
    "p_value:f64 p_adjusted:f64 smallest_ratio:f64 base_typical_ns:f64 new_typical_ns:f64"
)
"""One statistic of one metric of one matched group, after the match columns. Null is what the samples do not support; times are infinite
where more messages were lost than the statistic leaves room for. `*_low*` and `*_high*` are the ends of an interval."""

BRIDGE_COST_SCHEMA = {
    "bridge": pl.String,
    **{name: dtype for name, dtype in schema_of(PARAMETER_COLUMNS).items() if name in BRIDGE_MATCH_COLUMNS},
    **COMPARISON_SCHEMA,
}

INTERFERENCE_SCHEMA = {
    **frame_schema("group:u32 alone_group:u32 flow:str with_flows:str"),
    **COMPARISON_SCHEMA,
    **frame_schema(
        "received_difference:f64 received_difference_low:f64 received_difference_high:f64 received_verdict:str"
    ),
}

HEAD_OF_LINE_SCHEMA = frame_schema(
    "group:u32 other_group:u32 flow:str other:str with_flows:str runs:u32 caught:u64 overtook:u64 overtook_ratio:f64 "
    "overtook_ratio_low:f64 overtook_ratio_high:f64 wait_p50_ns:f64 verdict:str"
)


COST_FRAMES = {
    "bridge_costs": BRIDGE_COST_SCHEMA,
    "interference": INTERFERENCE_SCHEMA,
    "head_of_line": HEAD_OF_LINE_SCHEMA,
}


FAN_OUT_TIMES = ("first_receiver", "last_receiver", "spread", "first_reply", "last_reply")
FAN_OUT_SCHEMA = frame_schema(
    "group:u32 groups:str runs:u32 receivers:u32 senders:u32 messages:u64 complete:u64 "
    + " ".join(f"{name}_p50_ns:f64 {name}_p99_ns:f64" for name in FAN_OUT_TIMES)
    + " bound_ns:i64 position_step_ns:f64 ping_cpu_percent:f64 relay_cpu_percent:f64 wire_bytes_per_receiver:f64 "
    "matched_p50_ns:f64 matched_max_ns:f64 missed_p50:f64 discovery_bytes_p50:f64 recorders:u32 processors:u32"
)
"""A row per set of runs with the same receivers, in a campaign with several receivers or senders; `group` is the first of `groups`.

`complete` messages reached all receivers and came back. `*_receiver` from T1 to T3 of the first and of the last relay on the ping's
clock, wrong by at most `bound_ns`; `spread` between the two; `*_reply` from T1 to T2. `position_step_ns`: how much later the median is
from one relay's number to the next. `relay_cpu_percent` of one relay, mean; `wire_bytes_per_receiver` sent by the ping (on loopback
both ways) per message; `matched_*` from the ping's endpoints to the first echo of the last relay, `missed` messages times receivers
lost until then. `recorders` of a run on the ping's machine."""

FAN_OUT_POSITION_SCHEMA = frame_schema(
    "group:u32 relay_id:u32 device:str messages:u64 received:u64 outbound_p50_ns:f64 after_first_p50_ns:f64 first_share:f64 last_share:f64"
)
"""A row per relay of a row of `FAN_OUT_SCHEMA` with several: shares are of the complete messages that it got first, and last."""

FAN_OUT_FRAMES = {"fan_out": FAN_OUT_SCHEMA, "fan_out_positions": FAN_OUT_POSITION_SCHEMA}


class Overtaking(Enum):
    WAITS = "waits"
    OVERTAKES = "overtakes"
    UNDECIDED = "undecided"
    FEW = "too few messages"


HOP_SCHEMA = frame_schema(
    "chain:u32 hop:u32 topic:str next_topic:str from_event:str to_event:str ping_device:str relay_device:str messages:u64 "
    "p50_ns:f64 p99_ns:f64 max_ns:f64 bound_ns:i64 share:f64"
)
"""By hop: `stamp` to `publish`, `publish` to `receive`, `receive` to the next topic's `publish`; of the last, the `share` of inputs that led to an output."""

MESSAGE_COLUMNS = {
    "sequence": pl.UInt64,
    "publish_ns": pl.Int64,
    "relay_in_ns": pl.Int64,
    "header_ns": pl.Int64,
    "one_way_ns": pl.Int64,
    "age_ns": pl.Int64,
    "bound_ns": pl.Int64,
    "stamp_to_publish_ns": pl.Int64,
    "message_bytes": pl.UInt32,
    "outcome": pl.String,
    "duplicates": pl.UInt16,
    "reordered": pl.Boolean,
}
"""`publish_ns` on the publisher's monotonic clock, `relay_in_ns` on the tap's, null if lost; `header_ns` as it was sent, null without;
`one_way_ns` and `age_ns` are wrong by at most `bound_ns`; the rest as in `roundtrips`."""

TOPIC_MESSAGE_SCHEMA = {**schema_of(ROUNDTRIP_COLUMNS), **MESSAGE_COLUMNS}

TOPIC_STATISTICS = ("p50", "p90", "p99", "max")

TOPIC_SCHEMA = frame_schema(
    "topic:str message_type:str ping_device:str relay_device:str clock:str publishers:u32 runs:u64 published:u64 received:u64 "
    "lost_outbound:u64 lost_unknown:u64 offered:str subscribed:str duplicates:u64 reordered:u64 received_ratio:f64 duration_ns:i64 rate_hz:f64 "
    "message_bytes:f64 transfer_rate_bytes_per_s:f64 period_p50_ns:f64 period_p99_ns:f64 jitter_ns:f64 "
    + " ".join(f"{metric}_{statistic}_ns:f64" for metric in TOPIC_METRICS for statistic in TOPIC_STATISTICS)
    + " bound_ns:i64"
)
"""`ping_device` is the publisher's, `relay_device` the tap's; `bound_ns` the largest. `rate_hz` is what was published, heard or not.
`offered` is the reliability of the publishers, `subscribed` that of the taps. `jitter_ns` is 1.4826 times the
median absolute deviation of the intervals between arrivals."""


@dataclass(frozen=True, slots=True, eq=False)
class Topics:
    topics: pl.DataFrame
    topic_messages: pl.DataFrame
    topic_hops: pl.DataFrame
    wall_readings: tuple[Any, ...] = ()

    @classmethod
    def none(cls) -> Topics:
        topics, messages, hops = (pl.DataFrame(schema=row) for row in (TOPIC_SCHEMA, TOPIC_MESSAGE_SCHEMA, HOP_SCHEMA))
        return cls(topics, messages, hops)
