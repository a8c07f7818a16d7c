"""Messages of rosbag1, rosbag2 or MCAP by topic: times, size and header stamp."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from dds_trace.tracefile.format.bag_metadata import METADATA_NAME, RecordedTopic
from dds_trace.tracefile.format.encoding import decode_string
from dds_trace.tracefile.format.events import PUBLISHER_TOPIC, Stage
from dds_trace.tracefile.format.json_fields import JsonObject, number_of, object_of, parse_json
from dds_trace.tracefile.reading.source import RawMessage
from dds_trace.tracefile.reading.storage import find_storage

from .clocks import DAY_NS, find_resets, of_one_clock
from .header_stamps import known_definition, lost_by_recorder, parse_definition, plain_name, stamp_reader
from .losses import COMMANDS, LOST_TYPE, NONE, TopicTimes
from .periods import Int64
from .read import content_hash

_LONGEST_FRAME_BYTES = 256
_LEAST_ASCENDING = 0.9
_AROUND = 5

_TEXTS = ("ros1msg", "ros2msg")

_SUFFIXES = (".mcap", ".bag", ".bag.active", ".db3", ".mcap.zstd", ".db3.zstd")


def find_recordings(path: str | os.PathLike[str], *, skip: Collection[str | os.PathLike[str]] = ()) -> list[Path]:
    """Find `.mcap`, `.bag`, `.db3` files and rosbag2 folders below a folder, sorted; or the path itself.

    Raises:
        MissingEventsError: there is no such file or folder.
    """
    return find_storage(
        path, skip, lambda folder: (folder / METADATA_NAME).is_file(), _SUFFIXES, "a bag, or a folder with bags"
    )


_COLUMNS = ("log_ns", "publish_ns", "stamp_ns", "payload_bytes", "sequence", "publisher", "frame", "content", "number")


@dataclass(slots=True)
class TopicMessages:
    """Messages of one topic, 72 bytes each; `bound_ns` is of stamps on the recorder's clock.

    Publishers differ by `publisher` (rosbag1) or perhaps by `frame`; messages of unlike `content` are no copies; `number` is of all topics.
    """

    topic: RecordedTopic
    columns: dict[str, array[int]] = field(default_factory=lambda: {name: array("q") for name in _COLUMNS})
    lost: dict[str, tuple[int, int]] = field(default_factory=dict)
    publishers: dict[str, JsonObject] = field(default_factory=dict)
    bound_ns: int | None = None

    def __len__(self) -> int:
        return len(self.columns["log_ns"])

    def add(self, message: RawMessage, number: int) -> None:
        stamp, begins_with_header = _readers_of(message.topic)
        data, sequence = message.data, message.sequence
        if message.topic.encoding == "ros1":  # a converter's numbers are of all topics
            sequence = int.from_bytes(data[:4], "little") if begins_with_header else None
        values = (
            message.log_ns,
            message.publish_ns,
            stamp(data) if stamp else None,
            len(data),
            sequence,
            hash(message.topic.publisher),
            hash(_frame(data)) if begins_with_header else 0,
            content_hash(data),
            number,
        )
        for column, value in zip(self.columns.values(), values, strict=True):
            column.append(NONE if value is None else value)
        if self.topic.message_type == LOST_TYPE:
            for topic, transport, recorder in lost_by_recorder(data):
                before = self.lost.get(topic, (0, 0))
                self.lost[topic] = before[0] + transport, before[1] + recorder
        elif self.topic.name == PUBLISHER_TOPIC:
            with suppress(ValueError):
                record = object_of(parse_json(decode_string(data)))
                self.publishers[f"{record.get('session_id')} {record.get('publisher_id')}"] = record

    def extend(self, others: TopicMessages, number: int) -> None:
        """Append the messages of a following file, before which `number` messages of all topics were read."""
        for name, column in self.columns.items():
            values = others.columns[name]
            column.extend(array("q", [value + number for value in values]) if name == "number" else values)
        for topic, (transport, recorder) in others.lost.items():
            before = self.lost.get(topic, (0, 0))
            self.lost[topic] = before[0] + transport, before[1] + recorder
        self.publishers |= others.publishers

    def column(self, name: str) -> Int64:
        """In stored order; `NONE` for a value that a message lacks."""
        return np.frombuffer(self.columns[name], np.int64)

    def change_of_age_ns(self, start: int) -> float | None:
        """Return None where stamps do not go on."""
        log_ns, stamp_ns = (
            self.column(name)[max(start - _AROUND, 0) : start + _AROUND] for name in ("log_ns", "stamp_ns")
        )
        middle = min(start, _AROUND)
        if (stamp_ns == NONE).any() or not 0 <= stamp_ns[middle] - stamp_ns[middle - 1] < DAY_NS:
            return None
        age_ns = log_ns - stamp_ns
        return float(np.median(age_ns[middle:]) - np.median(age_ns[:middle]))

    def move(self, start: int, by_ns: int, *, with_stamps: bool) -> None:
        for name in ("log_ns", "publish_ns", "stamp_ns"):
            times_ns = self.column(name).copy()
            around = times_ns[start - 1 : start + 1] if start else times_ns[:0]
            is_known = len(around) == 2 and NONE not in around
            went_back = around[1] - around[0] < -by_ns / 2 if is_known else with_stamps
            if name == "log_ns" or went_back:
                times_ns[start:][times_ns[start:] != NONE] += by_ns
                self.columns[name] = array("q", times_ns.tobytes())

    @property
    def copies(self) -> int:
        keys = np.array([self.columns["log_ns"], self.columns["content"]])
        keys = keys[:, np.lexsort(keys)]
        return int((keys[:, 1:] == keys[:, :-1]).all(axis=0).sum())

    def times(self, first_ns: int, last_ns: int, lost: tuple[int, int] | None, counter: str) -> TopicTimes:
        """Return messages of the recording's clock by log time, all if none is."""
        log_ns = self.column("log_ns")
        order = np.argsort(log_ns, kind="stable")  # chunks may overlap in time
        inside = order[(log_ns[order] >= first_ns) & (log_ns[order] <= last_ns)]
        order = inside if len(inside) else order
        stamps = self.column("stamp_ns")
        stamped_within = (stamps >= stamps[order].min()) & (stamps <= stamps[order].max())
        stamped_within[order] = False
        log, publish, stamp, payload, sequence, publisher, frame = (self.column(name)[order] for name in _COLUMNS[:-2])
        is_ros1 = self.topic.encoding == "ros1"
        commands = any(map(COMMANDS.search, (self.topic.name, self.topic.message_type)))
        return TopicTimes(
            *(log, publish, stamp, payload, sequence, publisher, frame, is_ros1, commands, lost, counter),
            stamps[stamped_within],
        )


def run_on_after_resets(columns: Sequence[TopicMessages]) -> Iterator[tuple[int, int, int]]:
    """Let times go on where a clock was reset; yield when, by how much, and the topics with stamps that went on."""
    log_ns, number = (np.concatenate([topic.column(name) for topic in columns]) for name in ("log_ns", "number"))
    by_time = np.argsort(log_ns, kind="stable")
    by_time = by_time[of_one_clock(log_ns[by_time])]
    stored = np.sort(number[by_time])
    in_order_ns = log_ns[np.argsort(number)][stored]
    resets = find_resets(in_order_ns)
    if resets and any(topic.copies for topic in columns):
        return  # a merged bag
    moved_ns = 0
    for at in resets:
        parts = [(topic, int(np.searchsorted(topic.column("number"), stored[at]))) for topic in columns]
        shared = [(topic, start) for topic, start in parts if 0 < start < len(topic)]
        if 2 * sum(len(topic) - start for topic, start in shared) < len(stored) - at:
            continue  # files of several recorders
        back_ns = int(in_order_ns[at - 1] - in_order_ns[at] + np.median(np.abs(np.diff(in_order_ns))))
        younger_ns = [-change_ns for topic, start in shared if (change_ns := topic.change_of_age_ns(start)) is not None]
        going_on_ns = [change_ns for change_ns in younger_ns if back_ns / 2 < change_ns < 2 * back_ns]
        back_ns = round(float(np.median(going_on_ns))) if going_on_ns else back_ns
        for topic, start in parts:
            topic.move(start, back_ns, with_stamps=not going_on_ns)
        moved_ns += back_ns
        yield int(in_order_ns[at - 1]) + moved_ns - back_ns, back_ns, len(going_on_ns)


def leave_out_shared_numbers(columns: Sequence[TopicMessages]) -> None:
    """Take off the numbers of a converter's counter of all topics, which say nothing of one."""
    rows = [
        np.array([topic.column("log_ns"), topic.column("sequence"), np.full(len(topic), at)])
        for at, topic in enumerate(columns)
    ]
    ordered = np.concatenate(rows, axis=1)
    ordered = ordered[:, np.lexsort(ordered[1::-1])]
    is_other_topic = np.diff(ordered[2]) != 0
    if is_other_topic.any() and (np.diff(ordered[1])[is_other_topic] > 0).mean() > _LEAST_ASCENDING:
        for topic in columns:
            topic.columns["sequence"] = array("q", [NONE]) * len(topic)


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


@lru_cache(maxsize=10_000)
def _readers_of(topic: RecordedTopic) -> tuple[Callable[[bytes], int | None] | None, bool]:
    definition = topic.definition if topic.definition_encoding in _TEXTS else ""
    definition = definition or known_definition(topic.message_type)
    stamp = stamp_reader(topic.message_type, definition, topic.encoding)
    fields = parse_definition(topic.message_type, definition)[plain_name(topic.message_type)]
    return stamp, stamp is not None and fields[0].type == "std_msgs/Header" and fields[0].length is None


def _frame(data: bytes) -> bytes:
    """Return the frame of a header: publishers often differ by it."""
    size = int.from_bytes(data[12:16], "little")
    return data[16 : 16 + size] if size < _LONGEST_FRAME_BYTES else b""
