"""Rows of topics: rate, sizes and ages of what was received."""

from __future__ import annotations

import re

import numpy as np

from ..model.metrics import frame_schema
from .clocks import Stamps, age_course, count_latched, growth_since_ns
from .losses import NONE
from .periods import Int64

Row = dict[str, str | int | float | None]
"""Column of `TOPIC_SCHEMA` -> value; others are null."""

GAP_PERIODS = 2.0
"""Least length of a gap in median intervals."""

_FEWEST_FOR_P99 = 100
_FEWEST_STAMPS, _FEWEST_BURSTS, _FEWEST_IN_BURST = 8, 4, 3
_LEAST_REPEATED, _LEAST_EQUAL_BURSTS = 0.25, 0.6
_SECOND_NS, _MS_NS = 10**9, 10**6

TOPIC_SCHEMA = frame_schema(
    "recording:str topic:str message_type:str encoding:str messages:u64 start_ns:i64 duration_ns:i64 "
    "rate_hz:f64 period_p50_ns:f64 period_p99_ns:f64 jitter_ns:f64 gaps:u64 gap_max_ns:i64 "
    "payload_mean_bytes:f64 payload_min_bytes:u64 payload_max_bytes:u64 rate_bytes_per_s:f64 age_from:str "
    "age_messages:u64 age_negative:u64 age_min_ns:i64 age_p50_ns:f64 age_p99_ns:f64 age_max_ns:i64 "
    "stamps_backwards:u64 expected_rate_hz:f64 missing_from:str missing:u64 missing_low:u64 missing_high:u64 "
    "missing_inside:u64 lost_in_transport:u64 lost_in_recorder:u64 copies:u64 qos:str age_bound_ns:i64 "
    "age_start_ns:f64 age_end_ns:f64 age_since_ns:i64 age_max_at_ns:i64 age_resolution_ns:i64 latched:u64 burst_messages:u64 burst_ns:f64 burst_pause_ns:f64"
)

HOLE_SCHEMA = frame_schema("recording:str topic:str start_s:f64 duration_s:f64 missing:u64 inside:bool")


def timing(log_ns: Int64) -> Row:
    duration_ns = int(log_ns[-1] - log_ns[0])
    row: Row = {"start_ns": int(log_ns[0]), "duration_ns": duration_ns}
    if duration_ns:
        period_ns = np.diff(log_ns)
        median = float(np.median(period_ns))
        row |= {
            "rate_hz": len(period_ns) / (duration_ns / 1e9),
            "period_p50_ns": median,
            "period_p99_ns": float(np.quantile(period_ns, 0.99)) if len(period_ns) >= _FEWEST_FOR_P99 else None,
            "gaps": int((period_ns > GAP_PERIODS * median).sum()),
            "gap_max_ns": int(period_ns.max()),
        }
    return row


def sizes(payload_bytes: Int64, duration_ns: int) -> Row:
    total = int(payload_bytes.sum())
    return {
        "payload_mean_bytes": total / len(payload_bytes),
        "payload_min_bytes": int(payload_bytes.min()),
        "payload_max_bytes": int(payload_bytes.max()),
        "rate_bytes_per_s": total / (duration_ns / 1e9) if duration_ns else None,
    }


def ages(log_ns: Int64, publish_ns: Int64, stamp_ns: Int64, recording_ns: int) -> Row:
    stamped = stamp_ns != NONE
    published = publish_ns != NONE
    if stamped.any():
        age_from, log_ns, stamp_ns = "header", log_ns[stamped], stamp_ns[stamped]
    elif (published & (publish_ns != log_ns)).any():  # most recorders write the log time twice
        age_from, log_ns, stamp_ns = "publish", log_ns[published], publish_ns[published]
    else:
        return {"age_from": None}
    age_ns = log_ns - stamp_ns
    start_ns, end_ns = age_course(age_ns)
    row: Row = {
        "age_from": age_from,
        "age_messages": len(age_ns),
        "age_negative": int((age_ns < 0).sum()),
        "age_min_ns": int(age_ns.min()),
        "age_p50_ns": float(np.median(age_ns)),
        "age_p99_ns": float(np.quantile(age_ns, 0.99)) if len(age_ns) >= _FEWEST_FOR_P99 else None,
        "age_max_ns": int(age_ns.max()),
        "age_start_ns": start_ns,
        "age_end_ns": end_ns,
        "age_since_ns": growth_since_ns(log_ns, stamp_ns),
        "age_max_at_ns": int(log_ns[np.argmax(age_ns)]),
    }
    if age_from == "header":
        row |= {
            "age_resolution_ns": _resolution_ns(stamp_ns),
            "stamps_backwards": int((np.diff(stamp_ns) < 0).sum()),
            "latched": count_latched(Stamps(log_ns, stamp_ns), recording_ns),
        }
    return row


def _resolution_ns(stamp_ns: Int64) -> int | None:
    """Return the unit of stamps if it is a millisecond or, of several stamps each, a second; None for finer ones."""
    steps_ns = np.abs(np.diff(stamp_ns))
    unit_ns = int(np.gcd.reduce(steps_ns)) if len(steps_ns) >= _FEWEST_STAMPS else 0
    if unit_ns % _SECOND_NS == 0 and unit_ns and (steps_ns == 0).mean() > _LEAST_REPEATED:
        return _SECOND_NS if not (stamp_ns % _SECOND_NS).any() else None
    return _MS_NS if unit_ns == _MS_NS and not (stamp_ns % _MS_NS).any() else None


def bursts(log_ns: Int64) -> Row:
    """Return how many messages typically come at once, in what time, and the pause that follows."""
    steps_ns = np.diff(log_ns)
    if len(steps_ns) < _FEWEST_STAMPS:
        return {}
    mean_ns = float(steps_ns.mean())
    pauses = np.flatnonzero(steps_ns > mean_ns)
    counts = np.diff(pauses)
    if len(counts) < _FEWEST_BURSTS or np.median(steps_ns[steps_ns <= mean_ns]) > mean_ns / 4:
        return {}
    size = int(np.median(counts))
    if size < _FEWEST_IN_BURST or (counts == size).mean() < _LEAST_EQUAL_BURSTS:
        return {}
    pause_ns = float(np.median(steps_ns[pauses]))
    lasting_ns = log_ns[pauses[1:]] - log_ns[pauses[:-1] + 1]
    return {"burst_messages": size, "burst_ns": float(np.median(lasting_ns)), "burst_pause_ns": pause_ns}


_QOS_KEYS = re.compile(r"^[-\s]*(reliability|durability|history|depth): *(\S+)", re.MULTILINE)
_QOS_NUMBERS = {
    "reliability": {"1": "reliable", "2": "best_effort"},
    "durability": {"1": "transient_local", "2": "volatile"},
    "history": {"1": "keep_last", "2": "keep_all"},
}


def qos_words(profiles: str) -> str:
    """Return the first QoS profile of YAML in words: `reliable, volatile, keep_last 10`."""
    policies: dict[str, str] = {}
    for key, value in _QOS_KEYS.findall(profiles):
        policies.setdefault(key, _QOS_NUMBERS.get(key, {}).get(value, value))
    if policies.get("history") == "keep_last" and "depth" in policies:
        policies["history"] += f" {policies['depth']}"
    return ", ".join(policies[key] for key in ("reliability", "durability", "history") if policies.get(key, "0") != "0")
