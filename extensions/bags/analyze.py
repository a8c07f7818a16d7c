"""Topics of other recordings, and whether these are whole: what is missing, where, what is broken."""

from __future__ import annotations

import os
from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import TypeAlias

import polars as pl

from dds_trace.analyzer.model.finding import Source
from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.base.extension import load
from dds_trace.base.units import counted, first_of
from dds_trace.tracefile.format.bag_metadata import MOST_TOPICS

from .bounds import SHOWN
from .card import DAMAGED, HOLE_SCHEMA, TOPIC_SCHEMA, VERDICTS, WHOLE, Card, RecordingHealth
from .chains import Link
from .kinds import SUFFIX_WORDS
from .messages import MessageColumns, TopicMessages, count_copies, find_recordings
from .observations import OBSERVATION_SCHEMA, Observation
from .periods import Int64
from .read import read_batches
from .recorded import NONE, Condition
from .splits import Part, Span, goes_on, lost_files, parts_of, shown_path
from .sync import Sync


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TopicReport:
    """Topics, and the recordings with what was wrong with them.

    `rate_hz` = (messages - 1) / duration (of the recording where no rate is steady), `expected_rate_hz` while no message is missing; `jitter_ns` a robust standard deviation of the
    intervals between log times (1.4826 median deviations); `gaps` over two medians; `missing` null where nothing is known
    (not periodic, no counter), `missing_inside` while all topics stopped; `age_from` `header` (log time - header stamp), `publish` (log
    time - publish time) or null; `age_negative` logged before their stamp; `age_bound_ns` the largest error of corrected ages, null for others; `stamps_backwards` header stamps older than the previous one.

    `links` and `syncs` are by recording. `strips` has by row of `topics` the share of time without holes in `STRIP_PARTS` equal parts of the recording.
    """

    topics: pl.DataFrame
    sources: tuple[Source, ...]
    holes: pl.DataFrame
    recordings: tuple[RecordingHealth, ...]
    strips: tuple[tuple[float, ...], ...]
    observations: pl.DataFrame
    links: tuple[tuple[str, Link], ...] = ()
    syncs: tuple[tuple[str, Sync], ...] = ()

    def __repr__(self) -> str:
        parts = counted(len(self.recordings), "recording"), counted(len(self.topics), "topic")
        return f"<TopicReport: {', '.join(parts)}, {counted(len(self.holes), 'hole')}; .verdict {self.verdict}, .topics, .holes>"

    def _repr_markdown_(self) -> str:
        shown: str = load("parts", "bag_report")(self)._repr_markdown_()
        return shown

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
    sync: Sequence[str] = (),
) -> TopicReport:
    """Analyze the topics of every recording in a folder and below it, or of one recording.

    Args:
        path: a folder, a file of `kinds.RECORDING_KINDS`, or a rosbag2 folder; or a list of such.
        skip: files and folders to leave out.
        progress: called before each recording is read.
        clock: places header stamps of another device on the recorder's clock.
        sync: two topics whose stamps are compared.

    Raises:
        MissingEventsError: there is no recording, or none of them can be read at all.
    """
    parts = [path] if isinstance(path, str | os.PathLike) else path
    files = sorted({file for part in parts for file in find_recordings(part, skip=skip)})
    folders = Counter(file.parent for file in files)
    cards, sources = list[Card](), list[Source]()
    for recording in chain.from_iterable(_recordings(group, progress) for group in parts_of(files)):
        shown, condition = shown_path(recording.parts, folders), recording.condition
        if clock is not None:
            condition.notes += _correct(recording.columns.values(), clock)
        is_read, text = bool(recording.columns or not recording.failure), condition.damages
        if is_read:
            cards.append(Card(shown, [recording.columns[key] for key in sorted(recording.columns)], condition, sync))
            text = [*cards[-1].health.damages, *cards[-1].health.notes]
        status = "read" if not condition.damages else "truncated" if is_read else "skipped"
        messages = sum(map(len, recording.columns.values()))
        sources.append(Source(shown, status, "; ".join(first_of(text, SHOWN)), messages))
    if not cards:
        names = ["" if source.path in map(str, parts) else f"{source.path}: " for source in sources[:SHOWN]]
        reasons = "; ".join(f"{name}{source.detail}" for name, source in zip(names, sources, strict=False))
        raise MissingEventsError(
            f"{', '.join(map(str, parts))}: no recording that can be read{f' ({reasons})' if reasons else ''}; give a "
            f"{SUFFIX_WORDS} file, or a rosbag2 folder"
        )
    values = attrgetter(*(field.name for field in fields(Observation)))
    observed = [(card.health.path, *values(row)) for card in cards for row in card.observed]
    return TopicReport(
        pl.DataFrame([row for card in cards for row in card.rows], schema=TOPIC_SCHEMA),
        tuple(sorted(sources, key=lambda source: source.path)),
        pl.DataFrame([hole for card in cards for hole in card.holes], schema=HOLE_SCHEMA),
        tuple(card.health for card in cards),
        tuple(strip for card in cards for strip in card.strips),
        pl.DataFrame(observed, OBSERVATION_SCHEMA, orient="row"),
        tuple((card.health.path, link) for card in cards for link in card.links),
        tuple((card.health.path, one) for card in cards for one in card.syncs),
    )


_TopicKey: TypeAlias = tuple[str, str, str]
_Columns: TypeAlias = dict[_TopicKey, TopicMessages]


@dataclass(slots=True)
class _Recording:
    parts: list[Part]
    condition: Condition
    columns: dict[tuple[str, str, str], TopicMessages]
    failure: str = ""
    following: list[_Columns] = field(default_factory=list)
    """Of its further files, until `join`."""

    @property
    def span(self) -> Span:
        first_ns = min(int(topic.column("log_ns").min()) for topic in self.columns.values())
        last_ns = max(int(topic.column("log_ns").max()) for topic in self.columns.values())
        return Span(self.parts[0].number or 0, first_ns, last_ns)

    def append(self, other: _Recording) -> None:
        for kind in ("damages", "notes"):
            texts = [f"{other.parts[0].path.name}: {text}" for text in getattr(other.condition, kind)]
            getattr(self.condition, kind).extend(texts)
        self.condition.chunks += other.condition.chunks
        self.condition.topics |= other.condition.topics
        self.condition.is_remainder |= other.condition.is_remainder
        self.condition.gone += other.condition.gone
        self.following.append(other.columns)
        self.parts += other.parts

    def join(self) -> None:
        files, number = defaultdict[_TopicKey, list[TopicMessages]](list), 0
        for columns in (self.columns, *self.following):
            for key, messages in columns.items():
                messages.columns["number"] = messages.column("number") + number
                files[key].append(messages)
            number += sum(map(len, columns.values()))
        self.columns = {key: TopicMessages.joined(parts) for key, parts in files.items()}
        self.following.clear()


def _recordings(group: Sequence[Part], progress: Callable[[Path], None] | None) -> Iterator[_Recording]:
    whole, spans = None, list[Span]()
    for part in group:
        if progress is not None:
            progress(part.path)
        read = _read(part)
        if whole is not None and read.columns and goes_on(spans, read.span):
            spans.append(read.span)
            whole.append(read)
            continue
        if whole is not None:
            whole.join()
            yield whole
        whole, spans = (read, [read.span]) if read.columns else (None, [])
        if whole is None:
            yield read
    if whole is not None:
        whole.join()
        whole.condition.damages += lost_files(whole.parts)
        yield whole


def _read(part: Part) -> _Recording:
    recording, messages = _Recording([part], Condition(), {}), MessageColumns()
    try:
        for batch in read_batches(part.path, recording.condition):
            messages.add(batch)
    except TraceFormatError as err:
        recording.failure = err.what
        recording.condition.damages.append(err.what)
    topics = messages.by_topic()
    if len(topics) > MOST_TOPICS:  # more than any robot has
        recording.failure = f"it has {len(topics)} topics; at most {MOST_TOPICS} of a recording are analyzed"
        recording.condition.damages.append(recording.failure)
        topics.clear()
    count_copies(topics, partial(read_batches, part.path, Condition()))
    names = ((one.topic.name, one.topic.message_type, one.topic.encoding) for one in topics)
    recording.columns = dict(zip(names, topics, strict=True))
    return recording
