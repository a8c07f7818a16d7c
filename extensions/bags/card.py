"""The health of a recording: losses by topic, what stopped all of them, what its clocks did, what is broken."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dds_trace.analyzer.model.metrics import frame_schema
from dds_trace.base.units import clock_words, counted, format_duration
from dds_trace.tracefile.format.events import TOPIC_PREFIX
from dds_trace.tracefile.reading.source import Condition

from .clocks import (
    DAY_NS,
    SIMULATED_BEFORE_NS,
    Stamps,
    age_course,
    apart,
    backwards_ns,
    count_latched,
    growth_since_ns,
    of_one_clock,
    reset_note,
    set_back,
    stamp_notes,
)
from .losses import NONE, Losses, TopicTimes
from .messages import TopicMessages, counts_of_recorder, leave_out_shared_numbers, run_on_after_resets
from .periods import Int64, spread
from .read import copied_messages

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


OTHER_CLOCK_NS = DAY_NS
"""Median age of stamps of another clock (a simulation's, or of another day)."""

_MOST_HOLES = 1000
STRIP_PARTS = 60
WHOLE, HOLES, DAMAGED = VERDICTS = "whole", "holes", "damaged"
"""The worst last."""

_STALL_PERIODS = 2.5
"""Least silence of all topics in periods of the fastest one."""

_PAUSE_MESSAGES, _LEAST_SILENCE_NS = 20, 10**9


@dataclass(frozen=True, slots=True)
class RecordingHealth:
    """One recording: `start_ns` since 1970, `coverage` the share of its time outside of pauses of all topics."""

    path: str
    verdict: str
    start_ns: int
    duration_ns: int
    messages: int
    chunks: int
    coverage: float
    damages: tuple[str, ...]
    notes: tuple[str, ...]
    pauses: tuple[tuple[float, float], ...] = ()


class Card:
    def __init__(self, path: str, columns: Sequence[TopicMessages], condition: Condition) -> None:
        self._path, self._notes = path, [*condition.notes]
        resets = [] if condition.damages else list(run_on_after_resets(columns))  # single pages come last
        logged = np.sort(np.concatenate([topic.column("log_ns") for topic in columns]))
        logged = self._of_one_clock(logged)
        self._start_ns, self._end_ns = int(logged[0]), int(logged[-1])
        self._notes += [reset_note(back_ns, at_ns - self._start_ns, stamped) for at_ns, back_ns, stamped in resets]
        leave_out_shared_numbers(columns)
        lost, counter = counts_of_recorder(columns)
        within = self._start_ns, self._end_ns
        times = [topic.times(*within, lost.get(topic.topic.name), counter) for topic in columns]
        set_over = self._note_clocks(columns, times)
        pauses_of_all = _all_silent(logged, columns)
        for start, end in pauses_of_all:
            still = [t.is_still(start + 1, end - start) for t in times if t.has_stamps_around(start, end)]
            if still and all(still):  # a simulation that is paused or reset sends nothing
                set_over.append((start, end))
        losses = [  # a tap's own topics are events
            Losses()
            if topic.topic.name.startswith(TOPIC_PREFIX)
            else topic_times.find_losses(*within, set_over, pauses_of_all)
            for topic, topic_times in zip(columns, times, strict=True)
        ]
        pauses, stalls = _find_silences(logged, losses)
        if stalls:
            longest_ns, start, _ = max(stalls)
            self._notes.append(
                f"the recorder stalled {'once' if len(stalls) == 1 else f'{len(stalls)} times'}, for up to {format_duration(longest_ns)} at "
                f"{clock_words((start - self._start_ns) / 1e9)}: about {sum(late for *_, late in stalls):,} messages of all topics came late at "
                "once, none of them is lost by it"
            )
        if self._start_ns < SIMULATED_BEFORE_NS:
            self._notes.append("the log times are of a simulation's clock, or count from the start of a machine")
        silent = sorted({topic.name for topic in condition.topics} - {topic.topic.name for topic in columns})
        if silent:
            more = f" and {len(silent) - 3} more" if len(silent) > 3 else ""
            self._notes.append(f"no message of {', '.join(silent[:3])}{more}")
        self.rows: list[Row] = []
        self.holes: list[dict[str, object]] = []
        self.strips: list[tuple[float, ...]] = []
        for topic, topic_times, loss in zip(columns, times, losses, strict=True):
            self._add(topic, topic_times, loss, pauses)
        has_holes = pauses or any((row["missing_low"] or 0) for row in self.rows)
        duration_ns = self._end_ns - self._start_ns
        paused_ns = sum(end - start for start, end in pauses)
        self.health = RecordingHealth(
            path,
            DAMAGED if condition.damages else HOLES if has_holes else WHOLE,
            self._start_ns,
            duration_ns,
            sum(len(topic) for topic in columns),
            len(condition.chunks),
            1 - paused_ns / duration_ns if duration_ns else 1.0,
            tuple(condition.damages),
            (*self._notes, *_overlaps(condition.chunks)),
            tuple(((start - self._start_ns) / 1e9, (end - start) / 1e9) for start, end in pauses),
        )

    def _of_one_clock(self, logged: Int64) -> Int64:
        is_of_clock = of_one_clock(logged)
        if not is_of_clock.all():
            others = logged[~is_of_clock]
            away_ns = float(np.abs(np.median(others) - np.median(logged[is_of_clock])))
            is_earlier = others[-1] < logged[is_of_clock][0]
            which = (
                "of another clock (a simulation before its first /clock?)"
                if is_earlier
                else "their times are no clock's"
            )
            self._notes.append(
                f"{counted(len(others), 'message')} logged {apart(away_ns)} from the others: {which}, left out of rates and holes"
            )
        return logged[is_of_clock]

    def _note_clocks(self, columns: Sequence[TopicMessages], times: Sequence[TopicTimes]) -> list[tuple[int, int]]:
        stamped: dict[str, Stamps] = {}
        unstamped: list[Int64] = []
        for topic, topic_times in zip(columns, times, strict=True):
            has_stamp = topic_times.stamp_ns != NONE
            self._notes += copied_messages(topic.topic.name, topic.copies)
            if has_stamp.any():
                stamped[topic.topic.name] = Stamps(topic_times.log_ns[has_stamp], topic_times.stamp_ns[has_stamp])
            else:
                unstamped.append(topic_times.log_ns)
        self._notes += set_back({topic.topic.name: backwards_ns(topic.column("log_ns")) for topic in columns})
        notes, set_over = stamp_notes(stamped, unstamped, self._start_ns)
        self._notes += notes
        return set_over

    def _add(self, topic: TopicMessages, times: TopicTimes, losses: Losses, pauses: Sequence[tuple[int, int]]) -> None:
        regularity, about = losses.regularity, topic.topic
        lag = regularity.in_pattern if regularity else 1
        inside = [any(hole.overlaps(*pause) for pause in pauses) for hole in losses.holes]
        transport, recorder = times.lost or (None, None)
        row: Row = {
            "recording": self._path,
            "topic": about.name,
            "message_type": about.message_type,
            "encoding": about.encoding,
            "messages": len(topic),
            **timing(times.log_ns),
            "jitter_ns": spread(times.log_ns[lag:] - times.log_ns[:-lag]) if len(times.log_ns) > lag else None,
            **sizes(times.payload_bytes, int(times.log_ns[-1] - times.log_ns[0])),
            **ages(times.log_ns, times.publish_ns, times.stamp_ns, self._start_ns),
            **bursts(times.log_ns),
            "age_bound_ns": topic.bound_ns,
            "expected_rate_hz": regularity.rate_hz if regularity else None,
            "missing_from": losses.evidence,
            "missing": losses.missing,
            "missing_low": losses.low,
            "missing_high": losses.high,
            "missing_inside": None
            if losses.missing is None
            else max(
                sum(hole.missing for hole, is_in in zip(losses.holes, inside, strict=True) if is_in), recorder or 0
            ),
            "lost_in_transport": transport,
            "lost_in_recorder": recorder,
            "copies": topic.copies,
            "qos": qos_words(about.qos),
        }
        self.rows.append(row)
        self.strips.append(self._strip(times.log_ns, losses))
        largest = sorted(zip(losses.holes, inside, strict=True), key=lambda pair: -pair[0].duration_ns)[:_MOST_HOLES]
        self.holes += [
            {
                "recording": self._path,
                "topic": about.name,
                "start_s": (hole.start_ns - self._start_ns) / 1e9,
                "duration_s": hole.duration_ns / 1e9,
                "missing": hole.missing,
                "inside": is_in,
            }
            for hole, is_in in sorted(largest, key=lambda pair: pair[0].start_ns)
        ]

    def _strip(self, log_ns: Int64, losses: Losses) -> tuple[float, ...]:
        edges = np.linspace(self._start_ns, max(self._end_ns, self._start_ns + 1), STRIP_PARTS + 1)
        part_ns = edges[1] - edges[0]
        if losses.regularity is None:
            return tuple(np.minimum(np.histogram(log_ns, edges)[0], 1).astype(float).tolist())
        share = np.ones(STRIP_PARTS)
        before = int(log_ns[0])
        for start, end in [
            (self._start_ns, before),
            *((hole.start_ns, hole.start_ns + hole.duration_ns) for hole in losses.holes),
        ]:
            share -= np.maximum(np.minimum(edges[1:], end) - np.maximum(edges[:-1], start), 0) / part_ns
        return tuple(np.clip(share, 0, 1).tolist())


def _all_silent(logged: Int64, columns: Sequence[TopicMessages]) -> list[tuple[int, int]]:
    steps_ns = np.diff(logged)
    if len(columns) < 2 or not len(steps_ns):
        return []
    gaps = np.flatnonzero(steps_ns > max(_LEAST_SILENCE_NS, _PAUSE_MESSAGES * float(np.median(steps_ns))))
    return [(int(logged[at]), int(logged[at + 1])) for at in gaps.tolist()]


def _find_silences(logged: Int64, losses: Sequence[Losses]) -> tuple[list[tuple[int, int]], list[tuple[int, int, int]]]:
    """Return pauses of the recorder, in which several topics lack messages, and its stalls: length, start, late messages."""
    regular = [loss for loss in losses if loss.regularity]
    rates_hz = [loss.regularity.rate_hz for loss in regular if loss.regularity]
    pauses, stalls = list[tuple[int, int]](), list[tuple[int, int, int]]()
    if len(rates_hz) < 2:
        return pauses, stalls
    per_ns = sum(rates_hz) / 1e9
    steps_ns = np.diff(logged)
    for at in np.flatnonzero(steps_ns > _PAUSE_MESSAGES / per_ns).tolist():
        start, end = int(logged[at]), int(logged[at + 1])
        if sum(any(hole.missing and hole.overlaps(start, end) for hole in loss.holes) for loss in regular) >= 2:
            pauses.append((start, end))
            continue
        late_starts = [hole for loss in losses for hole in loss.holes[:1] if hole.start_ns == logged[0]]
        window_ns = (end - start) / 4
        late = int(np.searchsorted(logged, end + window_ns, "right")) - at - 1 - round(per_ns * window_ns)
        is_start = any(hole.overlaps(start, end) for hole in late_starts if not hole.missing)
        is_long = end - start > _STALL_PERIODS * 1e9 / max(rates_hz)
        if is_long and late > per_ns * (end - start) / 2 and not is_start:
            stalls.append((end - start, start, late))
    return pauses, stalls


def _overlaps(chunks: Sequence[tuple[int, int, int]]) -> Iterator[str]:
    latest_ns, overlapping = -(2**63), 0
    for first_ns, last_ns, _ in chunks:
        overlapping += first_ns < latest_ns
        latest_ns = max(latest_ns, last_ns)
    if overlapping:
        yield f"{overlapping} of {counted(len(chunks), 'chunk')} {'begins' if overlapping == 1 else 'begin'} before the end of an earlier one"
