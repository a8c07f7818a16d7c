"""Topics of other recordings, and whether these are whole: what is missing, where, what is broken."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import polars as pl

from dds_trace.analyzer.model.finding import Source
from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.tracefile.reading.source import Condition

from .card import DAMAGED, HOLE_SCHEMA, TOPIC_SCHEMA, VERDICTS, WHOLE, Card, RecordingHealth, Row, empty_health
from .losses import NONE
from .messages import TopicMessages, find_recordings
from .observations import OBSERVATION_SCHEMA
from .periods import Int64
from .read import read_messages

_MOST_NOTES = 10


@dataclass(frozen=True, slots=True, eq=False)
class TopicReport:
    """Topics, and the recordings with what was wrong with them.

    `rate_hz` = (messages - 1) / duration, `expected_rate_hz` while no message is missing; `jitter_ns` a robust standard deviation of the
    intervals between log times (1.4826 median deviations); `gaps` over `GAP_PERIODS` medians; `missing` null where nothing is known
    (not periodic, no counter), `missing_inside` while all topics stopped; `age_from` `header` (log time - header stamp), `publish` (log
    time - publish time) or null; `age_negative` logged before their stamp; `age_bound_ns` the largest error of corrected ages, null for others; `stamps_backwards` header stamps older than the previous one.

    `strips` has by row of `topics` the share of time without holes in `STRIP_PARTS` equal parts of the recording.
    """

    topics: pl.DataFrame
    sources: tuple[Source, ...]
    holes: pl.DataFrame
    recordings: tuple[RecordingHealth, ...]
    strips: tuple[tuple[float, ...], ...]
    observations: pl.DataFrame

    @property
    def verdict(self) -> str:
        verdicts = {health.verdict for health in self.recordings}
        if any(source.status != "read" for source in self.sources) or DAMAGED in verdicts:
            return DAMAGED
        return max(verdicts, key=VERDICTS.index, default=WHOLE)


StampCorrector: TypeAlias = Callable[
    [Mapping[str, tuple[Int64, Int64]]], tuple[Mapping[str, tuple[Int64, Int64]], list[str]]
]
"""From log times and stamps: stamps on the recorder's clock and bounds by topic, and notes."""


def _correct(columns: Collection[TopicMessages], clock: StampCorrector) -> list[str]:
    times = {}
    for topic in columns:
        log_ns, stamp_ns = topic.column("log_ns"), topic.column("stamp_ns")
        has_stamp = stamp_ns != NONE
        times[topic.topic.name] = log_ns[has_stamp], stamp_ns[has_stamp]
    corrected, notes = clock(times)
    for topic in columns:
        if topic.topic.name in corrected:
            placed_ns, bound_ns = corrected[topic.topic.name]
            stamp_ns = topic.column("stamp_ns").copy()
            stamp_ns[stamp_ns != NONE] = placed_ns
            topic.columns["stamp_ns"] = array("q", stamp_ns.tobytes())
            topic.bound_ns = int(bound_ns.max())
    return notes


def analyze_topics(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    skip: Collection[str | os.PathLike[str]] = (),
    progress: Callable[[Path], None] | None = None,
    clock: StampCorrector | None = None,
) -> TopicReport:
    """Analyze the topics of every recording in a folder and below it, or of one recording.

    Args:
        path: a folder, a `.mcap`, `.bag` or `.db3` file, or a rosbag2 folder; or a list of such.
        skip: files and folders to leave out.
        progress: called before each recording is read.
        clock: places header stamps of another device on the recorder's clock.

    Raises:
        MissingEventsError: there is no recording, or none of them can be read at all.
    """
    rows: list[Row] = []
    holes: list[dict[str, object]] = []
    sources: list[Source] = []
    health: list[RecordingHealth] = []
    strips: list[tuple[float, ...]] = []
    observations: list[dict[str, object]] = []
    parts = [path] if isinstance(path, str | os.PathLike) else path
    for recording in sorted({file for part in parts for file in find_recordings(part, skip=skip)}):
        if progress is not None:
            progress(recording)
        condition, columns, failure = Condition(), dict[tuple[str, str, str], TopicMessages](), ""
        try:
            for number, message in enumerate(read_messages(recording, condition)):
                topic = message.topic
                key = topic.name, topic.message_type, topic.encoding
                if key not in columns:
                    columns[key] = TopicMessages(topic)
                columns[key].add(message, number)
        except TraceFormatError as err:
            failure = err.what
            condition.damages.append(err.what)
        if clock is not None:
            condition.notes += _correct(columns.values(), clock)
        if columns:
            card = Card(str(recording), [columns[key] for key in sorted(columns)], condition)
            rows += card.rows
            holes += card.holes
            strips += card.strips
            observations += card.observations
            health.append(card.health)
        elif not failure:
            health.append(empty_health(str(recording), condition))
        text = [*health[-1].damages, *health[-1].notes] if columns or not failure else condition.damages
        status = "read" if not condition.damages else "truncated" if columns or not failure else "skipped"
        detail = "; ".join(text[:_MOST_NOTES])
        if len(text) > _MOST_NOTES:
            detail += f"; and {len(text) - _MOST_NOTES} more"
        sources.append(Source(str(recording), status, detail, sum(map(len, columns.values()))))
    if not any(source.status != "skipped" for source in sources):
        names = ["" if source.path in map(str, parts) else f"{source.path}: " for source in sources[:3]]
        reasons = "; ".join(f"{name}{source.detail}" for name, source in zip(names, sources, strict=False))
        raise MissingEventsError(
            f"{', '.join(map(str, parts))}: no recording that can be read{f' ({reasons})' if reasons else ''}; give a .mcap, .bag or "
            ".db3 file, or a rosbag2 folder"
        )
    frame = pl.DataFrame(rows, schema=TOPIC_SCHEMA)
    observed = pl.DataFrame(observations, schema=OBSERVATION_SCHEMA)
    return TopicReport(
        frame, tuple(sources), pl.DataFrame(holes, schema=HOLE_SCHEMA), tuple(health), tuple(strips), observed
    )
