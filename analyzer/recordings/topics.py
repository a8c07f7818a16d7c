"""Topics of other recordings: rate, gaps, jitter, size, and age from stamp or publishing to the log."""

from __future__ import annotations

import os
from array import array
from dataclasses import dataclass, field
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.base.units import counted
from dds_trace.tracefile.reading.recording_files import copied_messages

from ..model.finding import Source
from ..model.metrics import frame_schema
from .messages import find_recordings, iter_messages

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from .messages import RecordedMessage, Topic

    Row = dict[str, str | int | float | None]
    """Column of `TOPIC_SCHEMA` -> value; a column that is missing is null."""

Int64 = NDArray[np.int64]

GAP_PERIODS = 2.0
"""Least length of a gap in median intervals: at least one message is missing."""

_FEWEST_FOR_P99 = 100

OTHER_CLOCK_NS = 86_400 * 1_000_000_000
"""Median age from which on stamps are of another clock (a simulation's, or of another day)."""

_MOST_NOTES = 10

_NONE = -(2**63)

TOPIC_SCHEMA = frame_schema(
    "recording:str topic:str message_type:str encoding:str messages:u64 start_ns:i64 duration_ns:i64 "
    "rate_hz:f64 period_p50_ns:f64 period_p99_ns:f64 jitter_ns:f64 gaps:u64 gap_max_ns:i64 "
    "payload_mean_bytes:f64 payload_min_bytes:u64 payload_max_bytes:u64 rate_bytes_per_s:f64 age_from:str "
    "age_messages:u64 age_negative:u64 age_min_ns:i64 age_p50_ns:f64 age_p99_ns:f64 age_max_ns:i64 "
    "stamps_backwards:u64"
)


@dataclass(frozen=True, slots=True, eq=False)
class TopicReport:
    """The topics of some recordings, and the recordings with what was wrong with them.

    `rate_hz` = (messages - 1) / duration; `jitter_ns` the standard deviation of the intervals between log times; `gaps` over
    `GAP_PERIODS` medians; `age_from` `header` (log time - header stamp), `publish` (log time - publish time) or null;
    `age_negative` logged before their stamp; `stamps_backwards` header stamps older than the previous one.
    """

    topics: pl.DataFrame
    sources: tuple[Source, ...]


def analyze_topics(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    skip: Collection[str | os.PathLike[str]] = (),
    progress: Callable[[Path], None] | None = None,
) -> TopicReport:
    """Analyze the topics of every recording in a folder and below it, or of one recording.

    Args:
        path: a folder, a `.mcap`, `.bag` or `.db3` file, or a rosbag2 folder; or a list of such.
        skip: files and folders to leave out.
        progress: called before each recording is read.

    Raises:
        MissingEventsError: there is no recording, or none of them can be read at all.
    """
    rows: list[Row] = []
    sources: list[Source] = []
    parts = [path] if isinstance(path, str | os.PathLike) else path
    for recording in sorted({file for part in parts for file in find_recordings(part, skip=skip)}):
        if progress is not None:
            progress(recording)
        columns: dict[Topic, _Columns] = {}
        status, detail = "read", ""
        notes: list[str] = []
        other_clock: dict[str, float] = {}
        try:
            for message in iter_messages(recording, notes):
                columns.setdefault(message.topic, _Columns()).add(message)
        except TraceFormatError as err:
            status, detail = ("truncated" if columns else "skipped"), err.what
        for topic, messages_of_topic in sorted(columns.items(), key=lambda item: (item[0].name, item[0].message_type)):
            row = _describe(topic, messages_of_topic)
            rows.append({"recording": str(recording), **row})
            notes += copied_messages(topic.name, messages_of_topic.copies)
            age_ns = row.get("age_p50_ns")
            if isinstance(age_ns, float) and abs(age_ns) > OTHER_CLOCK_NS:
                other_clock[topic.name] = abs(age_ns)
        notes += _other_clock(other_clock)
        detail = "; ".join([*([detail] if detail else []), *notes[:_MOST_NOTES]])
        if len(notes) > _MOST_NOTES:
            detail += f"; and {len(notes) - _MOST_NOTES} more"
        messages = sum(len(topic.log_ns) for topic in columns.values())
        sources.append(Source(str(recording), status, detail, messages))
    if not any(source.status != "skipped" for source in sources):
        reasons = "; ".join(f"{source.path}: {source.detail}" for source in sources[:3])
        raise MissingEventsError(
            f"{', '.join(map(str, parts))}: no recording that can be read (.mcap, .bag, rosbag2 folder){': ' * bool(reasons)}{reasons}"
        )
    return TopicReport(pl.DataFrame(rows, schema=TOPIC_SCHEMA), tuple(sources))


@dataclass(slots=True)
class _Columns:
    """The messages of one topic while a recording is read: 40 bytes each."""

    log_ns: array[int] = field(default_factory=lambda: array("q"))
    publish_ns: array[int] = field(default_factory=lambda: array("q"))
    stamp_ns: array[int] = field(default_factory=lambda: array("q"))
    payload_bytes: array[int] = field(default_factory=lambda: array("q"))
    content: array[int] = field(default_factory=lambda: array("q"))

    def add(self, message: RecordedMessage) -> None:
        self.log_ns.append(message.log_ns)
        self.publish_ns.append(_NONE if message.publish_ns is None else message.publish_ns)
        self.stamp_ns.append(_NONE if message.stamp_ns is None else message.stamp_ns)
        self.payload_bytes.append(message.payload_bytes)
        self.content.append(message.content)

    @property
    def copies(self) -> int:
        """Messages whose log time and content another one has."""
        keys = np.array([self.log_ns, self.content])
        keys = keys[:, np.lexsort(keys)]
        return int((keys[:, 1:] == keys[:, :-1]).all(axis=0).sum())


def _other_clock(ages_ns: dict[str, float]) -> Iterator[str]:
    """Yield a note on the topics with stamps of another clock."""
    if ages_ns:
        topic, age_ns = max(ages_ns.items(), key=itemgetter(1))
        days = age_ns / OTHER_CLOCK_NS
        apart = f"{days / 365.25:.0f} years" if days > 365.25 else f"{days:.0f} days"
        more = f" and {counted(len(ages_ns) - 1, 'more topic')}" if len(ages_ns) > 1 else ""
        yield f"stamps of {topic}{more} are {apart} from the log times: of another clock (a simulation?), not an age"


def _describe(topic: Topic, columns: _Columns) -> Row:
    log_ns, publish_ns, stamp_ns, payload_bytes = (
        np.frombuffer(column, np.int64)
        for column in (columns.log_ns, columns.publish_ns, columns.stamp_ns, columns.payload_bytes)
    )
    order = np.argsort(log_ns, kind="stable")  # chunks may overlap in time
    log_ns, publish_ns, stamp_ns = log_ns[order], publish_ns[order], stamp_ns[order]
    return {
        "topic": topic.name,
        "message_type": topic.message_type,
        "encoding": topic.encoding,
        "messages": len(log_ns),
        **_timing(log_ns),
        **_sizes(payload_bytes, int(log_ns[-1] - log_ns[0])),
        **_ages(log_ns, publish_ns, stamp_ns),
    }


def _timing(log_ns: Int64) -> Row:
    duration_ns = int(log_ns[-1] - log_ns[0])
    row: Row = {"start_ns": int(log_ns[0]), "duration_ns": duration_ns}
    if duration_ns:
        period_ns = np.diff(log_ns)
        median = float(np.median(period_ns))
        row |= {
            "rate_hz": len(period_ns) / (duration_ns / 1e9),
            "period_p50_ns": median,
            "period_p99_ns": float(np.quantile(period_ns, 0.99)) if len(period_ns) >= _FEWEST_FOR_P99 else None,
            "jitter_ns": float(period_ns.std(ddof=1)) if len(period_ns) > 1 else None,
            "gaps": int((period_ns > GAP_PERIODS * median).sum()),
            "gap_max_ns": int(period_ns.max()),
        }
    return row


def _sizes(payload_bytes: Int64, duration_ns: int) -> Row:
    total = int(payload_bytes.sum())
    return {
        "payload_mean_bytes": total / len(payload_bytes),
        "payload_min_bytes": int(payload_bytes.min()),
        "payload_max_bytes": int(payload_bytes.max()),
        "rate_bytes_per_s": total / (duration_ns / 1e9) if duration_ns else None,
    }


def _ages(log_ns: Int64, publish_ns: Int64, stamp_ns: Int64) -> Row:
    stamped = stamp_ns != _NONE
    published = publish_ns != _NONE
    if stamped.any():
        age_from, age_ns = "header", (log_ns - stamp_ns)[stamped]
    elif (published & (publish_ns != log_ns)).any():  # most recorders write the log time twice
        age_from, age_ns = "publish", (log_ns - publish_ns)[published]
    else:
        return {"age_from": None}
    return {
        "age_from": age_from,
        "age_messages": len(age_ns),
        "age_negative": int((age_ns < 0).sum()),
        "age_min_ns": int(age_ns.min()),
        "age_p50_ns": float(np.median(age_ns)),
        "age_p99_ns": float(np.quantile(age_ns, 0.99)) if len(age_ns) >= _FEWEST_FOR_P99 else None,
        "age_max_ns": int(age_ns.max()),
        "stamps_backwards": int((np.diff(stamp_ns[stamped]) < 0).sum()) if age_from == "header" else None,
    }
