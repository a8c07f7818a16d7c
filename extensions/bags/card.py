"""The health of a recording: losses by topic, what stopped all of them, what its clocks did, what is broken."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dds_trace.analyzer.model.metrics import frame_schema
from dds_trace.base.units import SECOND_NS, clock_words, counted, first_of, format_duration

from .bounds import DAY_NS, FEWEST, SHOWN
from .chains import Link, Stamped, find_links
from .clocks import Clocks, Note, age_course, apart, backwards_ns, growth_since_ns, of_one_clock, reset_note, set_back
from .holes import Holes
from .losses import Losses, TopicTimes, resolution_ns
from .messages import TopicMessages, counts_of_recorder, leave_out_shared_numbers, run_on_after_resets
from .neighbours import find_silences
from .observations import Observation, has_losses, observe, rhythm_notes
from .periods import Int64
from .quantiles import median, named_quantile, spread
from .read import UNCOUNTED, copied_messages
from .recorded import NONE, Condition
from .sync import Sync, compare_stamps
from .weighing import Source, weigh

Row = dict[str, str | int | float | None]
"""Column of `TOPIC_SCHEMA` -> value; others are null."""

TOPIC_SCHEMA = frame_schema(
    "recording:str topic:str message_type:str encoding:str messages:u64 start_ns:i64 duration_ns:i64 "
    "rate_hz:f64 period_p50_ns:f64 period_p99_ns:f64 jitter_ns:f64 gaps:u64 gap_max_ns:i64 "
    "payload_mean_bytes:f64 payload_min_bytes:u64 payload_max_bytes:u64 rate_bytes_per_s:f64 age_from:str "
    "age_messages:u64 age_negative:u64 age_min_ns:i64 age_p50_ns:f64 age_p99_ns:f64 age_max_ns:i64 "
    "stamps_backwards:u64 expected_rate_hz:f64 missing_from:str missing:u64 missing_low:u64 missing_high:u64 "
    "missing_inside:u64 lost_in_transport:u64 lost_in_recorder:u64 copies:u64 qos:str age_bound_ns:i64 "
    "age_start_ns:f64 age_end_ns:f64 age_since_ns:i64 age_max_at_ns:i64 age_resolution_ns:i64 latched:u64 no_age:str burst_messages:u64 burst_ns:f64 burst_pause_ns:f64"
)

HOLE_SCHEMA = frame_schema("recording:str topic:str start_s:f64 duration_s:f64 missing:u64 missing_low:u64 inside:bool")


def timing(log_ns: Int64, recorded_ns: int) -> Row:
    """Return the times of a topic; `recorded_ns` is 0 for a steady one, since messages without a rhythm may be one burst."""
    duration_ns = int(log_ns[-1] - log_ns[0])
    row: Row = {"start_ns": int(log_ns[0]), "duration_ns": duration_ns}
    if duration_ns:
        period_ns = np.diff(log_ns)
        median_ns = median(period_ns)
        row |= {
            "rate_hz": len(period_ns) / (max(duration_ns, recorded_ns) / SECOND_NS),
            "period_p50_ns": median_ns,
            "period_p99_ns": named_quantile(period_ns, "p99"),
            "gaps": int((period_ns > 2 * median_ns).sum()),
            "gap_max_ns": int(period_ns.max()),
        }
    return row


def sizes(payload_bytes: Int64, duration_ns: int) -> Row:
    total = int(payload_bytes.sum())
    return {
        "payload_mean_bytes": total / len(payload_bytes),
        "payload_min_bytes": int(payload_bytes.min()),
        "payload_max_bytes": int(payload_bytes.max()),
        "rate_bytes_per_s": total / (duration_ns / SECOND_NS) if duration_ns else None,
    }


def ages(log_ns: Int64, publish_ns: Int64, stamp_ns: Int64, no_age: str | None) -> Row:
    """Return the differences to the header's stamp or, without one, to the publish time; ages only without a reason in `no_age`."""
    stamped, published = stamp_ns != NONE, publish_ns != NONE
    row: Row = {"age_from": None}
    if stamped.any():
        row |= {
            "age_from": "header",
            "age_resolution_ns": resolution_ns(stamp_ns[stamped]),
            "stamps_backwards": int((np.diff(stamp_ns[stamped]) < 0).sum()),
        }
        log_ns, stamp_ns = log_ns[stamped], stamp_ns[stamped]
    elif (
        no_age is None and (published & (publish_ns != 0) & (publish_ns != log_ns)).any()
    ):  # most recorders write the log time twice
        row["age_from"] = "publish"
        log_ns, stamp_ns = log_ns[published], publish_ns[published]
    if row["age_from"] is None:
        return row
    age_ns = log_ns - stamp_ns
    start_ns, end_ns = age_course(age_ns)
    return row | {
        "age_messages": len(age_ns),
        "age_negative": int((age_ns < 0).sum()),
        "age_min_ns": int(age_ns.min()),
        "age_p50_ns": median(age_ns),
        "age_p99_ns": named_quantile(age_ns, "p99"),
        "age_max_ns": int(age_ns.max()),
        "age_start_ns": start_ns,
        "age_end_ns": end_ns,
        "age_since_ns": growth_since_ns(log_ns, stamp_ns),
        "age_max_at_ns": int(log_ns[np.argmax(age_ns)]),
    }


def bursts(log_ns: Int64) -> Row:
    steps_ns = np.diff(log_ns)
    if len(steps_ns) < FEWEST:
        return {}
    mean_ns = float(steps_ns.mean())
    pauses = np.flatnonzero(steps_ns > mean_ns)
    counts = np.diff(pauses)
    if 2 * len(counts) < FEWEST or median(steps_ns[steps_ns <= mean_ns]) > mean_ns / (2 * 2):
        return {}
    size = int(median(counts))
    if size <= 2 or 2 * (counts == size).sum() < len(counts):
        return {}
    pause_ns = median(steps_ns[pauses])
    lasting_ns = log_ns[pauses[1:]] - log_ns[pauses[:-1] + 1]
    return {"burst_messages": size, "burst_ns": median(lasting_ns), "burst_pause_ns": pause_ns}


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

STRIP_PARTS = 60
"""Of the time of a recording, in its row of the table."""
WHOLE, UNKNOWN, HOLES, EMPTY, DAMAGED = VERDICTS = "whole", "unknown", "holes", "empty", "damaged"
"""The worst last."""


@dataclass(frozen=True, slots=True)
class RecordingHealth:
    """One recording: `start_ns` since 1970, `coverage` the share of its time outside of pauses of all topics.

    `readable` topics have a reading that could have shown a loss. `doubtful` pauses may be of the publishers.
    `gone` messages of topics that have none here were counted by the damaged original.
    It is `certain` that nothing is missing (`whole`) where some topic could have shown a loss, and none may lack one.
    """

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
    readable: int = 0
    doubtful: tuple[bool, ...] = ()
    certain: bool = False
    gone: int = 0


class Card:
    """What is said of one recording: its health, rows of topics, holes, strips and observations."""

    def __init__(
        self, path: str, columns: Sequence[TopicMessages], condition: Condition, sync: Sequence[str] = ()
    ) -> None:
        self._sync, self.links, self.syncs = sync, list[Link](), list[Sync]()
        self._path, self._notes, self._gone = path, [Note(note) for note in condition.notes], condition.gone.copy()
        if condition.is_remainder:
            count = f"{counted(condition.gone.total(), 'message')} that it counted {'is' if condition.gone.total() == 1 else 'are'} not here"
            self._note(f"recovered from a damaged recording: {count if condition.gone else UNCOUNTED}")
        self._start_ns, self._end_ns = 0, 0
        self.rows: list[Row] = []
        self.holes: list[dict[str, object]] = []
        self.strips: list[tuple[float, ...]] = []
        self.observed: list[Observation] = []
        losses, pauses, readable = self._weigh(columns, condition) if columns else ([], Holes(), 0)
        silent = sorted({topic.name for topic in condition.topics} - {topic.topic.name for topic in columns})
        if silent:
            self._note(f"no message of {', '.join(first_of(silent, SHOWN))}")
        self.observed += [Observation(note.topic, note.kind, words=note.words) for note in self._notes]
        duration_ns, paused_ns = self._end_ns - self._start_ns, int(pauses.duration_ns.sum())
        is_doubtful = np.ones(len(pauses), np.bool_)
        for loss in losses:
            is_doubtful &= ~pauses.meet(loss.holes.at(loss.holes.low > 0))
        is_certain = readable > 0 and not condition.is_remainder and not any(row["missing_high"] for row in self.rows)
        is_lossy = has_losses(self.observed) or self._gone
        sound = HOLES if is_lossy else WHOLE if is_certain else UNKNOWN if columns else EMPTY
        self.health = RecordingHealth(
            path,
            DAMAGED if condition.damages else sound,
            self._start_ns,
            duration_ns,
            sum(len(topic) for topic in columns),
            len(condition.chunks),
            1 - paused_ns / duration_ns if duration_ns else 1.0,
            tuple(condition.damages),
            tuple(note.words for note in self._notes),
            tuple(pauses.seconds(self._start_ns)),
            readable,
            tuple(is_doubtful.tolist()),
            is_certain,
            self._gone.total(),
        )

    def _weigh(self, columns: Sequence[TopicMessages], condition: Condition) -> tuple[list[Losses], Holes, int]:
        """Fill rows and observations; return the losses, the pauses of all topics, and how many topics could have shown a loss."""
        resets = [] if condition.damages else list(run_on_after_resets(columns))  # single pages come last
        logged = self._of_one_clock(np.sort(np.concatenate([topic.column("log_ns") for topic in columns])))
        self._start_ns, self._end_ns = int(logged[0]), int(logged[-1])
        words = [reset_note(back_ns, at_ns - self._start_ns, stamped) for at_ns, back_ns, stamped in resets]
        leave_out_shared_numbers(columns)
        words += [note for topic in columns for note in copied_messages(topic.topic.name, topic.copies)]
        words += set_back({topic.topic.name: backwards_ns(topic.column("log_ns")) for topic in columns})
        lost, counter = counts_of_recorder(columns)
        evidence = weigh(
            [topic.times(self._start_ns, self._end_ns, lost.get(topic.topic.name), counter) for topic in columns],
            [Source(topic.topic.name, "volatile" in qos_words(topic.topic.qos)) for topic in columns],
            logged,
        )
        self._notes += [*map(Note, words), *evidence.clocks.notes]
        pauses, stalls = find_silences(logged, evidence.losses)
        if stalls:
            longest_ns, start, _ = max(stalls)
            more = f" and {counted(len(stalls) - 1, 'more time')}" if len(stalls) > 1 else ""
            self._note(
                f"all topics: nothing for {'' if len(stalls) == 1 else 'up to '}{format_duration(longest_ns)} at "
                f"{clock_words((start - self._start_ns) / SECOND_NS)}{more}, then about {sum(late for *_, late in stalls):,} messages at once: late, not "
                "lost; the recorder or the way to it stalled"
            )
        for topic, times, loss, early in zip(columns, evidence.times, evidence.losses, evidence.history, strict=True):
            gone = self._gone.pop(topic.topic.name, 0)
            self._add(topic, times, loss.with_gone(gone), pauses, early, evidence.clocks)
        pairs = [*zip(columns, evidence.times, strict=True)]
        if self._sync:
            self.syncs.append(compare_stamps(self._sync, {topic.topic.name: times for topic, times in pairs}))
        no_age = evidence.clocks.no_age
        self.links = find_links(
            [
                Stamped(
                    one.topic.name, one.topic.message_type, times.log_ns, times.stamp_ns, one.topic.name not in no_age
                )
                for one, times in pairs
            ]
        )
        return evidence.losses, pauses, evidence.readable

    def _note(self, words: str) -> None:
        self._notes.append(Note(words))

    def _of_one_clock(self, logged: Int64) -> Int64:
        is_of_clock = of_one_clock(logged)
        if not is_of_clock.all():
            others = logged[~is_of_clock]
            away_ns = abs(median(others) - median(logged[is_of_clock]))
            is_earlier = others[-1] < logged[is_of_clock][0]
            which = (
                "of another clock (a simulation before its first /clock?)"
                if is_earlier
                else "their times are no clock's"
            )
            self._note(
                f"{counted(len(others), 'message')} logged {apart(away_ns)} from the others: {which}, left out of rates and holes"
            )
        return logged[is_of_clock]

    def _add(
        self, topic: TopicMessages, times: TopicTimes, losses: Losses, pauses: Holes, early: int, clocks: Clocks
    ) -> None:
        regularity, about, holes = losses.regularity, topic.topic, losses.holes
        lag = regularity.in_pattern if regularity else 1
        is_inside = holes.meet(pauses)
        inside = {*holes.start_ns[is_inside].tolist()}
        transport, recorder = times.lost or (None, None)
        no_age = clocks.no_age.get(about.name)
        row: Row = {
            "recording": self._path,
            "topic": about.name,
            "message_type": about.message_type,
            "encoding": about.encoding,
            "messages": len(topic),
            **timing(times.log_ns, 0 if regularity else self._end_ns - self._start_ns),
            "jitter_ns": spread(times.log_ns[lag:] - times.log_ns[:-lag]) if len(times.log_ns) > lag else None,
            **sizes(times.payload_bytes, int(times.log_ns[-1] - times.log_ns[0])),
            **ages(times.log_ns, times.publish_ns, times.stamp_ns, no_age),
            **bursts(times.log_ns),
            "latched": early,
            "no_age": no_age,
            "age_bound_ns": topic.bound_ns,
            "expected_rate_hz": regularity.rate_hz if regularity else None,
            "missing_from": losses.evidence,
            "missing": losses.missing,
            "missing_low": losses.low,
            "missing_high": losses.high,
            "missing_inside": None if losses.missing is None else max(int(holes.low[is_inside].sum()), recorder or 0),
            "lost_in_transport": transport,
            "lost_in_recorder": recorder,
            "copies": topic.copies,
            "qos": qos_words(about.qos),
        }
        self.rows.append(row)
        self.strips.append(self._strip(times.log_ns, losses))
        self._notes += rhythm_notes(about.name, times, self._start_ns) if regularity and losses.high else []
        observed = list(observe(about.name, losses, self._start_ns))
        self.observed += observed
        self.holes += [
            {
                "recording": self._path,
                "topic": about.name,
                "start_s": hole.start_s,
                "duration_s": hole.duration_s,
                "missing": hole.high,
                "missing_low": hole.low,
                "inside": self._start_ns + round(hole.start_s * SECOND_NS) in inside,
            }
            for hole in observed
            if hole.start_s is not None
        ]

    def _strip(self, log_ns: Int64, losses: Losses) -> tuple[float, ...]:
        edges = np.linspace(self._start_ns, max(self._end_ns, self._start_ns + 1), STRIP_PARTS + 1)
        if losses.regularity is None:
            return tuple(np.minimum(np.histogram(log_ns, edges)[0], 1).astype(float).tolist())
        drawn = losses.holes if losses.low else losses.holes.at(losses.holes.duration_ns > SECOND_NS)
        holes = Holes.of([Holes.between([self._start_ns], [int(log_ns[0])]), drawn])
        lengths = np.maximum(holes.duration_ns, 0)
        silent_ns = np.append(0, np.cumsum(lengths))
        # Time in holes before each edge: whole holes, and a part of the last that began.
        begun = np.searchsorted(holes.start_ns, edges, "right")
        last = np.maximum(begun - 1, 0)
        within = np.clip(edges - holes.start_ns[last], 0, lengths[last])
        before = np.where(begun > 0, silent_ns[last] + within, 0)
        share = 1 - np.diff(before) / (edges[1] - edges[0])
        return tuple(np.clip(share, 0, 1).tolist())
