"""Messages of rosbag1, rosbag2 or MCAP by topic, as columns: times, size, stamp of the header."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME, RecordedTopic
from dds_trace.tracefile.format.encoding import decode_string
from dds_trace.tracefile.format.events import PUBLISHER_TOPIC, Stage
from dds_trace.tracefile.format.json_fields import JsonObject, number_of, object_of, parse_json
from dds_trace.tracefile.mcapfile.scan import unaligned
from dds_trace.tracefile.reading.storage import find_storage

from .bounds import DAY_NS, FEWEST, MOST, NOTICED_NS
from .clocks import find_resets, of_one_clock
from .header_stamps import lost_by_recorder
from .kinds import RECORDING_KINDS
from .losses import COMMANDS, LOST_TYPE, TopicTimes
from .message_stamps import StampReader, stamps_of
from .periods import Int64
from .quantiles import median
from .recorded import NONE, MessageBatch

if TYPE_CHECKING:
    from array import array

Integers: TypeAlias = NDArray[np.integer[Any]]


_ENDINGS = tuple(ending for kind in RECORDING_KINDS for ending in (kind.suffix, *kind.endings))


def find_recordings(path: str | os.PathLike[str], *, skip: Collection[str | os.PathLike[str]] = ()) -> list[Path]:
    """Find files of `RECORDING_KINDS` and rosbag2 folders below a folder, sorted; or the path itself.

    Raises:
        MissingEventsError: there is no such file or folder.
    """
    return find_storage(
        path, skip, lambda folder: (folder / METADATA_NAME).is_file(), _ENDINGS, "a bag, or a folder with bags"
    )


_COLUMNS = ("log_ns", "publish_ns", "stamp_ns", "payload_bytes", "sequence", "frame")


@dataclass(slots=True)
class TopicMessages:
    """Messages of one topic in stored order, as columns; `bound_ns` is of stamps on the recorder's clock.

    Publishers differ by `publisher` (rosbag1) or perhaps by `frame`; `number` counts the messages of all topics.
    `copies` are there twice, with the same time and content.
    """

    topic: RecordedTopic
    columns: dict[str, Integers | array[int]]
    lost: dict[str, tuple[int, int]] = field(default_factory=dict)
    publishers: dict[str, JsonObject] = field(default_factory=dict)
    bound_ns: int | None = None
    copies: int = 0

    def __len__(self) -> int:
        return len(self.columns["log_ns"])

    @classmethod
    def joined(cls, files: Sequence[TopicMessages]) -> TopicMessages:
        if len(files) == 1:
            return files[0]
        columns = {name: np.concatenate([file.column(name) for file in files]) for name in files[0].columns}
        whole = cls(files[0].topic, dict(columns), copies=sum(file.copies for file in files))
        for file in files:
            whole.publishers |= file.publishers
            for topic, (transport, recorder) in file.lost.items():
                before = whole.lost.get(topic, (0, 0))
                whole.lost[topic] = before[0] + transport, before[1] + recorder
        return whole

    def column(self, name: str) -> Int64:
        """In stored order; `NONE` for a value that a message lacks."""
        return np.asarray(self.columns[name], np.int64)

    def change_of_age_ns(self, start: int) -> float | None:
        """Return None where stamps do not go on."""
        log_ns, stamp_ns = (
            self.column(name)[max(start - FEWEST, 0) : start + FEWEST] for name in ("log_ns", "stamp_ns")
        )
        middle = min(start, FEWEST)
        if (stamp_ns == NONE).any() or not 0 <= stamp_ns[middle] - stamp_ns[middle - 1] < DAY_NS:
            return None
        age_ns = log_ns - stamp_ns
        return median(age_ns[middle:]) - median(age_ns[:middle])

    def move(self, start: int, by_ns: int, *, with_stamps: bool) -> None:
        for name in ("log_ns", "publish_ns", "stamp_ns"):
            times_ns = self.column(name).copy()
            around = times_ns[start - 1 : start + 1] if start else times_ns[:0]
            is_known = len(around) == 2 and NONE not in around
            went_back = around[1] - around[0] < -by_ns / 2 if is_known else with_stamps
            if name == "log_ns" or went_back:
                times_ns[start:][times_ns[start:] != NONE] += by_ns
                self.columns[name] = times_ns

    def perhaps_copied(self) -> Int64:
        """Return the numbers of messages that share time, size and stamp with another."""
        keys = self.column("log_ns"), self.column("payload_bytes"), self.column("stamp_ns")
        if (np.diff(keys[0]) > 0).all():
            return np.empty(0, np.int64)
        order = np.lexsort(keys)
        is_equal = np.logical_and.reduce([np.diff(key[order]) == 0 for key in keys])
        is_shared = np.append(is_equal, False) | np.append(False, is_equal)
        numbers: Int64 = self.column("number")[order[is_shared]]
        return numbers

    def count_copies(self, contents: Mapping[int, int]) -> None:
        numbers = self.column("number")
        indices = np.flatnonzero(np.isin(numbers, np.array([*contents], np.int64)))
        keys = np.array([self.column("log_ns")[indices], [contents[number] for number in numbers[indices].tolist()]])
        keys = keys[:, np.lexsort(keys)]
        self.copies = int((keys[:, 1:] == keys[:, :-1]).all(axis=0).sum())

    def times(self, first_ns: int, last_ns: int, lost: tuple[int, int] | None, counter: str) -> TopicTimes:
        """Return messages of the recording's clock by log time, all if none is."""
        log_ns, stamps = self.column("log_ns"), self.column("stamp_ns")
        left_out_ns = stamps[:0]
        order: slice | Int64 = slice(None)
        if log_ns.min() < first_ns or log_ns.max() > last_ns or (np.diff(log_ns) < 0).any():  # chunks may overlap
            order = np.argsort(log_ns, kind="stable")
            inside = order[(log_ns[order] >= first_ns) & (log_ns[order] <= last_ns)]
            order = inside if len(inside) else order
            stamped_within = (stamps >= stamps[order].min()) & (stamps <= stamps[order].max())
            stamped_within[order] = False
            left_out_ns = stamps[stamped_within]
        names = ("log_ns", "publish_ns", "stamp_ns", "payload_bytes", "sequence", "publisher", "frame")
        log, publish, stamp, payload, sequence, publisher, frame = (self.column(name)[order] for name in names)
        is_ros1 = self.topic.encoding == "ros1"
        commands = any(map(COMMANDS.search, (self.topic.name, self.topic.message_type)))
        return TopicTimes(
            *(log, publish, stamp, payload, sequence, publisher, frame, is_ros1, commands, lost, counter), left_out_ns
        )


class MessageColumns:
    """Collects the messages of a recording as columns of all topics: a message costs their bytes, and no object."""

    def __init__(self) -> None:
        self._topics: Sequence[RecordedTopic] = ()
        self._parts: dict[str, list[Integers]] = {name: [] for name in ("topic", *_COLUMNS)}
        self._stamps = _Stamps()
        self._lost: dict[_TopicKey, dict[str, tuple[int, int]]] = {}
        self._publishers: dict[_TopicKey, dict[str, JsonObject]] = {}

    def add(self, batch: MessageBatch) -> None:
        self._topics = batch.topics
        self._stamps.know(batch.topics)
        stamp_ns, sequence, frame = self._stamps.columns_of(batch)
        columns: list[Integers] = [batch.topic.astype(np.int32), batch.log_ns, batch.publish_ns, stamp_ns]
        columns += [batch.sizes.astype(np.int32), sequence, frame]
        for parts, column in zip(self._parts.values(), columns, strict=True):
            parts.append(column)
        for index in np.flatnonzero(np.isin(batch.topic, self._stamps.counting)).tolist():
            self._count(batch.topics[batch.topic[index]], batch.content(index))

    def _count(self, topic: RecordedTopic, data: bytes) -> None:
        if topic.message_type == LOST_TYPE:
            lost = self._lost.setdefault(_key(topic), {})
            for name, transport, recorder in lost_by_recorder(data):
                before = lost.get(name, (0, 0))
                lost[name] = before[0] + transport, before[1] + recorder
            return
        with suppress(ValueError):
            record = object_of(parse_json(decode_string(data)))
            name = f"{record.get('session_id')} {record.get('publisher_id')}"
            self._publishers.setdefault(_key(topic), {})[name] = record

    def by_topic(self) -> list[TopicMessages]:
        """Return the messages of each topic, type and encoding, sorted by these, and forget them here."""
        topic_index = _joined(self._parts, "topic")
        first_rows = np.full(len(self._topics), len(topic_index))
        first_rows[topic_index[::-1]] = np.arange(len(topic_index) - 1, -1, -1)
        first_of: dict[_TopicKey, RecordedTopic] = {}
        for index in np.argsort(first_rows)[: int((first_rows < len(topic_index)).sum())].tolist():
            first_of.setdefault(_key(self._topics[index]), self._topics[index])
        keys = sorted(first_of)
        rank_of = {key: rank for rank, key in enumerate(keys)}
        ranks = np.array([rank_of.get(_key(topic), 0) for topic in self._topics], np.int32)[topic_index]
        codes = {publisher: code for code, publisher in enumerate({topic.publisher: 0 for topic in self._topics})}
        publisher = np.array([codes[topic.publisher] for topic in self._topics], np.int32)[topic_index]
        number = np.argsort(
            ranks.astype(np.uint16) if len(keys) <= np.iinfo(np.uint16).max else ranks, kind="stable"
        )  # by radix
        edges = np.cumsum(np.bincount(ranks, minlength=len(keys)))[:-1]
        del topic_index, ranks
        columns: dict[str, list[Integers]] = {"number": [*np.split(number, edges)]}
        columns["publisher"] = _split(publisher, number, edges)
        for name in _COLUMNS:
            columns[name] = _split(_joined(self._parts, name), number, edges)
        return [
            TopicMessages(
                first_of[key],
                {name: parts[rank] for name, parts in columns.items()},
                self._lost.get(key, {}),
                self._publishers.get(key, {}),
            )
            for rank, key in enumerate(keys)
        ]


_TopicKey: TypeAlias = tuple[str, str, str]


def _key(topic: RecordedTopic) -> _TopicKey:
    return topic.name, topic.message_type, topic.encoding


def _joined(parts: dict[str, list[Integers]], name: str) -> Integers:
    column = np.concatenate(parts[name]) if parts[name] else np.empty(0, np.int64)
    parts[name].clear()
    return column


def _split(column: Integers, number: Int64, edges: Int64) -> list[Integers]:
    parts = np.split(column[number], edges)
    return [np.broadcast_to(part[:1].copy(), part.shape) if (part[:1] == part).all() else part for part in parts]


def count_copies(columns: Sequence[TopicMessages], read_again: Callable[[], Iterator[MessageBatch]]) -> None:
    """Count messages that are there twice; content is read only of those that share what is cheap to compare."""
    perhaps = [(topic, numbers) for topic in columns if len(numbers := topic.perhaps_copied())]
    if not perhaps:
        return
    numbers = np.sort(np.concatenate([numbers for _, numbers in perhaps]))
    contents, first = dict[int, int](), 0
    with suppress(TraceFormatError):
        for batch in read_again():
            start, stop = np.searchsorted(numbers, (first, first + len(batch)))
            contents |= {at: hash(bytes(batch.content(at - first))) for at in numbers[start:stop].tolist()}
            first += len(batch)
            if stop == len(numbers):
                break
    for topic, _ in perhaps:
        topic.count_copies(contents)


_PLAIN_CDR = int.from_bytes(b"\0\1", "little")
_HEADER = struct.Struct("<4xii")
"""Encapsulation and stamp (CDR), or number and stamp (ROS 1); the length of the frame and the frame follow."""

_LENGTH, _WORD = np.dtype("<u4"), np.dtype("<u8")
_WEIGHTS = np.array([pow(0x9E3779B97F4A7C15, power, 1 << 64) for power in range(1, 35)], np.uint64)


class _Stamps:
    """Stamps, numbers and frames of messages, read as columns where their type has them at fixed offsets, else one by one."""

    def __init__(self) -> None:
        self._readers: list[StampReader | None] = []
        self._places = np.empty((0, 2), np.int64)
        self._flags = np.empty((0, 3), np.bool_)
        self.counting: list[int] = []

    def know(self, topics: Sequence[RecordedTopic]) -> None:
        new = topics[len(self._readers) :]
        if not new:
            return
        for index, topic in enumerate(new, len(self._readers)):
            self.counting += [index] * (topic.message_type == LOST_TYPE or topic.name == PUBLISHER_TOPIC)
            self._readers.append(stamps_of(topic))
        readers = self._readers[-len(new) :]
        places = [reader.place if reader and reader.place else None for reader in readers]
        rows = [
            (-1, -1) if place is None else (place.at, -1 if place.count_at is None else place.count_at)
            for place in places
        ]
        flags = [
            (reader is not None, reader is not None and reader.has_header, topic.encoding == "ros1")
            for reader, topic in zip(readers, new, strict=True)
        ]
        self._places = np.concatenate([self._places, np.array(rows, np.int64)])
        self._flags = np.concatenate([self._flags, np.array(flags, np.bool_)])

    def columns_of(self, batch: MessageBatch) -> tuple[Int64, Int64, Int64]:
        """Return stamps, sequence numbers and frames, `NONE` or 0 for those without."""
        has_stamp, has_header, is_ros1 = self._flags[batch.topic].T
        stamp_ns, is_read = self._stamps(batch, is_ros1)
        for index in np.flatnonzero(has_stamp & ~is_read).tolist():
            reader = self._readers[batch.topic[index]]
            value = reader.read(batch.content(index)) if reader else None
            stamp_ns[index] = NONE if value is None else value
        sequence = batch.sequence
        if is_ros1.any():  # a converter's numbers are of all topics
            rows = np.flatnonzero(is_ros1 & has_header & (batch.sizes >= 4))
            sequence = np.where(is_ros1, NONE, sequence)
            sequence[rows] = unaligned(batch.data, "<u4")[batch.starts[rows]]
        return stamp_ns, sequence, _frames(batch, has_header)

    def _stamps(self, batch: MessageBatch, is_ros1: NDArray[np.bool_]) -> tuple[Int64, NDArray[np.bool_]]:
        places, counts_at = self._places[batch.topic].T
        is_read = (places >= 0) & (batch.sizes >= places + 8)
        stamp_ns, rows = np.full(len(batch), NONE), np.flatnonzero(is_read)
        numbers, starts = unaligned(batch.data, "<u4"), batch.starts[rows]
        is_plain = is_ros1[rows] | (unaligned(batch.data, "<u2")[starts] == _PLAIN_CDR)
        counted = np.flatnonzero(counts_at[rows] >= 0)
        if len(counted):
            counts = numbers[starts[counted] + counts_at[rows[counted]]]
            is_plain[counted] &= (counts > 0) & (counts <= batch.sizes[rows[counted]])
        is_read[rows] = is_plain
        rows = rows[is_plain]
        at = batch.starts[rows] + places[rows]
        seconds = np.where(is_ros1[rows], numbers[at], unaligned(batch.data, "<i4")[at].astype(np.int64))
        stamps = seconds * 1_000_000_000 + numbers[at + 4]
        stamp_ns[rows] = np.where(stamps == 0, NONE, stamps)
        return stamp_ns, is_read


def _frames(batch: MessageBatch, has_header: NDArray[np.bool_]) -> Int64:
    """Return a number for each text of a header's frame, 0 without one: publishers often differ by it."""
    frames, frame_at = np.zeros(len(batch), np.uint64), _HEADER.size + _LENGTH.itemsize
    rows = np.flatnonzero(has_header & (batch.sizes >= frame_at))
    sizes = unaligned(batch.data, "<u4")[batch.starts[rows] + _HEADER.size].astype(np.int64)
    is_short = sizes < len(_WEIGHTS[:-2]) * _WORD.itemsize
    rows, sizes = rows[is_short], sizes[is_short]
    sizes = np.minimum(sizes, batch.sizes[rows] - frame_at)
    words, last_word = unaligned(batch.data, "<u8"), len(batch.data) - _WORD.itemsize
    are_equal = len(sizes) and sizes.min() == sizes.max()
    for size in (sizes[:1] if are_equal else np.unique(sizes)).tolist() if last_word >= 0 else ():
        of_size = rows[sizes == size]
        at, total = (
            batch.starts[of_size] + frame_at,
            np.full(len(of_size), size * int(_WEIGHTS[-1]) % (1 << 64), np.uint64),
        )
        for number, offset in enumerate(range(0, size, _WORD.itemsize)):
            beyond = np.maximum(at + offset - last_word, 0)  # in bytes, at the end of the data
            word = words[at + offset - beyond] >> (8 * beyond).astype(np.uint64)
            used_bits = 8 * min(size - offset, _WORD.itemsize)
            total += (word & np.uint64((1 << used_bits) - 1)) * _WEIGHTS[number]
        frames[of_size] = total
    return frames.view(np.int64)


def run_on_after_resets(columns: Sequence[TopicMessages]) -> Iterator[tuple[int, int, int]]:
    """Let times go on where a clock was reset; yield when, by how much, and the topics with stamps that went on."""
    in_order_ns = _in_stored_order(columns, "log_ns")
    if len(in_order_ns) < 2 or np.diff(in_order_ns).min() > -NOTICED_NS:  # as `find_resets` demands
        return
    log_ns = np.sort(in_order_ns)
    log_ns = log_ns[of_one_clock(log_ns)]
    stored = np.flatnonzero((in_order_ns >= log_ns[0]) & (in_order_ns <= log_ns[-1]))
    in_order_ns = in_order_ns[stored]
    resets = find_resets(in_order_ns)
    if resets and any(topic.copies for topic in columns):
        return  # a merged bag
    moved_ns = 0
    for at in resets:
        parts = [(topic, int(np.searchsorted(topic.column("number"), stored[at]))) for topic in columns]
        shared = [(topic, start) for topic, start in parts if 0 < start < len(topic)]
        if 2 * sum(len(topic) - start for topic, start in shared) < len(stored) - at:
            continue  # files of several recorders
        back_ns = int(in_order_ns[at - 1] - in_order_ns[at] + median(np.abs(np.diff(in_order_ns))))
        younger_ns = [-change_ns for topic, start in shared if (change_ns := topic.change_of_age_ns(start)) is not None]
        going_on_ns = [change_ns for change_ns in younger_ns if back_ns / 2 < change_ns < 2 * back_ns]
        back_ns = round(median(going_on_ns)) if going_on_ns else back_ns
        for topic, start in parts:
            topic.move(start, back_ns, with_stamps=not going_on_ns)
        moved_ns += back_ns
        yield int(in_order_ns[at - 1]) + moved_ns - back_ns, back_ns, len(going_on_ns)


def leave_out_shared_numbers(columns: Sequence[TopicMessages]) -> None:
    """Take off the numbers of a converter's counter of all topics, which say nothing of one."""
    log_ns, sequence = (_in_stored_order(columns, name) for name in ("log_ns", "sequence"))
    topic_index = np.empty(len(log_ns), np.int32)
    for index, topic in enumerate(columns):
        topic_index[topic.column("number")] = index
    if (np.diff(log_ns) <= 0).any():
        order = np.lexsort((sequence, log_ns))
        sequence, topic_index = sequence[order], topic_index[order]
    is_other_topic = np.diff(topic_index) != 0
    if is_other_topic.any() and (np.diff(sequence)[is_other_topic] > 0).mean() > MOST:
        for topic in columns:
            topic.columns["sequence"] = np.broadcast_to(np.array([NONE]), len(topic))


def _in_stored_order(columns: Sequence[TopicMessages], name: str) -> Int64:
    values = np.empty(sum(map(len, columns)), np.int64)
    for topic in columns:
        values[topic.column("number")] = topic.column(name)
    return values


def counts_of_recorder(columns: Sequence[TopicMessages]) -> tuple[dict[str, tuple[int, int]], str]:
    """Return what a tap, or rosbag2, lost of each topic by its own counts, on the way to it and inside, and which of both it was."""
    heard: dict[str, list[JsonObject]] = {}
    for record in (record for topic in columns for record in topic.publishers.values()):
        heard.setdefault(str(record.get("topic")), []).append(record)
    messages = {name: _total(records, "messages") or 0 for name, records in heard.items()}
    if heard and sum(messages.values()) == sum(
        len(topic) for topic in columns if topic.topic.name == Stage.TAP.topic
    ):  # else a part of its recording
        missing = {name: _total(records, "missing") for name, records in heard.items()}
        recorded = {topic.topic.name: len(topic) for topic in columns}
        return {
            name: (count, max(messages[name] - recorded.get(name, 0), 0))
            for name, count in missing.items()
            if count is not None
        }, "tap"
    lost = {name: numbers for topic in columns for name, numbers in topic.lost.items()}
    has_counts = any(topic.topic.message_type == LOST_TYPE for topic in columns)
    return {topic.topic.name: lost.get(topic.topic.name, (0, 0)) for topic in columns if has_counts}, "recorder"


def _total(records: Sequence[JsonObject], name: str) -> int | None:
    numbers = [number_of(record.get(name)) for record in records]
    return None if None in numbers else int(sum(filter(None, numbers)))
