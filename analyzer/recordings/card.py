"""The health of a recording: losses by topic, what stopped all of them, what its clocks did, what is broken."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from dds_trace.base.units import clock_words, counted, format_duration
from dds_trace.tracefile.reading.recorded import Condition
from dds_trace.tracefile.recordings.recording_files import copied_messages

from .clocks import DAY_NS, Stamps, apart, is_simulated, of_one_clock, set_back, stamp_notes
from .losses import LOST_TYPE, NONE, Losses, TopicTimes, arrival_jitter_ns
from .messages import TopicMessages
from .periods import Hole, Int64
from .rows import Row, ages, bursts, qos_words, sizes, timing

OTHER_CLOCK_NS = DAY_NS
"""Median age of stamps of another clock (a simulation's, or of another day)."""

_MOST_HOLES = 1000
STRIP_PARTS = 60
WHOLE, HOLES, DAMAGED = VERDICTS = "whole", "holes", "damaged"
"""The worst last."""

_STALL_PERIODS = 2.5
"""Least silence of all topics in periods of the fastest one."""

_PAUSE_MESSAGES = 20
"""Least messages that all topics together lack in a pause of the recorder."""


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
        logged = np.sort(np.concatenate([topic.column("log_ns") for topic in columns]))
        logged = self._of_one_clock(logged)
        self._start_ns, self._end_ns = int(logged[0]), int(logged[-1])
        lost = {name: counts for topic in columns for name, counts in topic.lost.items()}
        has_counts = any(topic.topic.message_type == LOST_TYPE for topic in columns)
        times = [
            topic.times(self._start_ns, self._end_ns, lost.get(topic.topic.name, (0, 0)) if has_counts else None)
            for topic in columns
        ]
        losses = [topic.find_losses(self._start_ns, self._end_ns) for topic in times]
        pauses = _find_pauses(logged, losses)
        self._notes += _stall_notes(logged, losses, pauses)
        self._note_clocks(columns, times)
        if is_simulated(self._start_ns):
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
            away_ns = float(np.abs(np.median(logged[~is_of_clock]) - np.median(logged[is_of_clock])))
            self._notes.append(
                f"{counted(int((~is_of_clock).sum()), 'message')} logged {apart(away_ns)} from the others: of another clock (a simulation before "
                "its first /clock?), left out of rates and holes"
            )
        return logged[is_of_clock]

    def _note_clocks(self, columns: Sequence[TopicMessages], times: Sequence[TopicTimes]) -> None:
        other_clock: dict[str, float] = {}
        stamped: dict[str, Stamps] = {}
        unstamped: list[Int64] = []
        for topic, topic_times in zip(columns, times, strict=True):
            name, has_stamp = topic.topic.name, topic_times.stamp_ns != NONE
            self._notes += copied_messages(name, topic.copies)
            self._notes += set_back(name, topic.column("log_ns"))
            if has_stamp.any():
                stamps = Stamps(topic_times.log_ns[has_stamp], topic_times.stamp_ns[has_stamp])
                stamped[name] = stamps
                age_ns = abs(float(np.median(stamps.age_ns)))
                if age_ns > OTHER_CLOCK_NS:
                    other_clock[name] = age_ns
            else:
                unstamped.append(topic_times.log_ns)
        self._notes += stamp_notes(stamped, unstamped, self._start_ns)
        self._notes += _other_clock(other_clock)

    def _add(self, topic: TopicMessages, times: TopicTimes, losses: Losses, pauses: Sequence[tuple[int, int]]) -> None:
        regularity, about = losses.regularity, topic.topic
        inside = [any(_overlap(hole, *pause) for pause in pauses) for hole in losses.holes]
        transport, recorder = times.lost or (None, None)
        row: Row = {
            "recording": self._path,
            "topic": about.name,
            "message_type": about.message_type,
            "encoding": about.encoding,
            "messages": len(topic),
            **timing(times.log_ns),
            "jitter_ns": arrival_jitter_ns(times.log_ns, regularity),
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


def _find_pauses(logged: Int64, losses: Sequence[Losses]) -> list[tuple[int, int]]:
    regular = [loss for loss in losses if loss.regularity is not None]
    rate_hz = sum(loss.regularity.rate_hz for loss in regular if loss.regularity)
    if len(regular) < 2 or not rate_hz:
        return []
    steps_ns = np.diff(logged)
    pauses = [
        (int(logged[at]), int(logged[at + 1])) for at in np.flatnonzero(steps_ns > _PAUSE_MESSAGES / rate_hz * 1e9)
    ]
    return [
        (start, end)
        for start, end in pauses
        if sum(any(hole.missing and _overlap(hole, start, end) for hole in loss.holes) for loss in regular) >= 2
    ]


def _stall_notes(logged: Int64, losses: Sequence[Losses], pauses: Sequence[tuple[int, int]]) -> Iterator[str]:
    rates_hz = [loss.regularity.rate_hz for loss in losses if loss.regularity]
    if len(rates_hz) < 2:
        return
    per_ns = sum(rates_hz) / 1e9
    least_ns = max(_STALL_PERIODS * 1e9 / max(rates_hz), _PAUSE_MESSAGES / per_ns)
    steps_ns = np.diff(logged)
    late_starts = [
        hole for loss in losses for hole in loss.holes[:1] if hole.start_ns == logged[0] and not hole.missing
    ]
    stalls: list[tuple[int, int, int]] = []
    for at in np.flatnonzero(steps_ns > least_ns).tolist():
        start, end = int(logged[at]), int(logged[at + 1])
        window_ns = (end - start) / 4
        came = int(np.searchsorted(logged, end + window_ns, "right")) - at - 1
        late = came - round(per_ns * window_ns)
        is_start = any(_overlap(hole, start, end) for hole in late_starts)
        is_pause = any(first < end and start < last for first, last in pauses)
        if late > per_ns * (end - start) / 2 and not is_start and not is_pause:
            stalls.append((end - start, start, late))
    if stalls:
        longest_ns, start, _ = max(stalls)
        what = "once" if len(stalls) == 1 else f"{len(stalls)} times"
        late = sum(count for _, _, count in stalls)
        yield (
            f"the recorder stalled {what}, for up to {format_duration(longest_ns)} at {clock_words((start - int(logged[0])) / 1e9)}: about "
            f"{late:,} messages of all topics came late at once, none of them is lost by it"
        )


def _overlap(hole: Hole, start_ns: int, end_ns: int) -> bool:
    return hole.start_ns < end_ns and start_ns < hole.start_ns + hole.duration_ns


def _overlaps(chunks: Sequence[tuple[int, int, int]]) -> Iterator[str]:
    latest_ns, overlapping = -(2**63), 0
    for first_ns, last_ns, _ in chunks:
        overlapping += first_ns < latest_ns
        latest_ns = max(latest_ns, last_ns)
    if overlapping:
        yield f"{overlapping} of {counted(len(chunks), 'chunk')} {'begins' if overlapping == 1 else 'begin'} before the end of an earlier one"


def _other_clock(ages_ns: dict[str, float]) -> Iterator[str]:
    if ages_ns:
        topic, age_ns = max(ages_ns.items(), key=itemgetter(1))
        more = f" and {counted(len(ages_ns) - 1, 'more topic')}" if len(ages_ns) > 1 else ""
        yield (
            f"stamps of {topic}{more} are {apart(age_ns)} from the log times: of another clock (a simulation?), not an age"
        )
