"""Messages of rosbag1, rosbag2 or MCAP by topic: times, size and header stamp."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from dds_trace.base.errors import MissingEventsError
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME
from dds_trace.tracefile.format.header_stamps import parse_definition, plain_name, stamp_reader
from dds_trace.tracefile.reading.recorded import RawMessage, RecordedTopic
from dds_trace.tracefile.recordings.recording_files import content_hash

from .losses import LOST_TYPE, NONE, TopicTimes, is_command, lost_by_recorder
from .periods import Int64

_LONGEST_FRAME_BYTES = 256

_TEXTS = ("ros1msg", "ros2msg")

_SUFFIXES = (".mcap", ".bag", ".bag.active", ".db3", ".mcap.zstd", ".db3.zstd")


def find_recordings(path: str | os.PathLike[str], *, skip: Collection[str | os.PathLike[str]] = ()) -> list[Path]:
    """Find `.mcap`, `.bag`, `.db3` files and rosbag2 folders below a folder, sorted; or the path itself.

    Raises:
        MissingEventsError: there is no such file or folder.
    """
    path, skipped = Path(path), {Path(other).resolve() for other in skip}
    if path.is_file() or (path / METADATA_NAME).is_file():
        return [path]
    if not path.is_dir():
        raise MissingEventsError(f"{path}: no such file or folder; give a bag, or a folder with bags")
    recordings: list[Path] = []
    for name, folders, files in os.walk(path):
        parent = Path(name)
        if parent.resolve() in skipped:
            folders.clear()
        elif METADATA_NAME in files:
            recordings.append(parent)
            folders.clear()
        else:
            unpacked = set(files)
            recordings += [
                parent / file
                for file in files
                if file.endswith(_SUFFIXES) and not (file.endswith(".zstd") and file[:-5] in unpacked)
            ]
    return sorted(recordings)


_COLUMNS = ("log_ns", "publish_ns", "stamp_ns", "payload_bytes", "sequence", "publisher", "frame", "content")


@dataclass(slots=True)
class TopicMessages:
    """Messages of one topic, 64 bytes each; `bound_ns` is of stamps on the recorder's clock.

    Publishers differ by `publisher` (rosbag1) or perhaps by `frame`; messages of unlike `content` are no copies.
    """

    topic: RecordedTopic
    columns: dict[str, array[int]] = field(default_factory=lambda: {name: array("q") for name in _COLUMNS})
    lost: dict[str, tuple[int, int]] = field(default_factory=dict)
    bound_ns: int | None = None

    def __len__(self) -> int:
        return len(self.columns["log_ns"])

    def add(self, message: RawMessage) -> None:
        stamp, begins_with_header = _readers_of(message.topic)
        data, sequence = message.data, message.sequence
        if begins_with_header and message.topic.encoding == "ros1":
            sequence = int.from_bytes(data[:4], "little")
        values = (
            message.log_ns,
            message.publish_ns,
            stamp(data) if stamp else None,
            len(data),
            sequence,
            hash(message.topic.publisher),
            hash(_frame(data)) if begins_with_header else 0,
            content_hash(data),
        )
        for column, value in zip(self.columns.values(), values, strict=True):
            column.append(NONE if value is None else value)
        if self.topic.message_type == LOST_TYPE:
            for topic, transport, recorder in lost_by_recorder(data):
                before = self.lost.get(topic, (0, 0))
                self.lost[topic] = before[0] + transport, before[1] + recorder

    def column(self, name: str) -> Int64:
        """In stored order; `NONE` for a value that a message lacks."""
        return np.frombuffer(self.columns[name], np.int64)

    @property
    def copies(self) -> int:
        keys = np.array([self.columns["log_ns"], self.columns["content"]])
        keys = keys[:, np.lexsort(keys)]
        return int((keys[:, 1:] == keys[:, :-1]).all(axis=0).sum())

    def times(self, first_ns: int, last_ns: int, lost: tuple[int, int] | None) -> TopicTimes:
        """Return messages of the recording's clock by log time, all if none is."""
        log_ns = self.column("log_ns")
        order = np.argsort(log_ns, kind="stable")  # chunks may overlap in time
        inside = order[(log_ns[order] >= first_ns) & (log_ns[order] <= last_ns)]
        order = inside if len(inside) else order
        stamps = self.column("stamp_ns")
        stamped_within = (stamps >= stamps[order].min()) & (stamps <= stamps[order].max())
        stamped_within[order] = False
        log, publish, stamp, payload, sequence, publisher, frame = (self.column(name)[order] for name in _COLUMNS[:-1])
        is_ros1 = self.topic.encoding == "ros1"
        commands = is_command(self.topic.name, self.topic.message_type)
        return TopicTimes(
            log, publish, stamp, payload, sequence, publisher, frame, is_ros1, commands, lost, stamps[stamped_within]
        )


@lru_cache(maxsize=10_000)
def _readers_of(topic: RecordedTopic) -> tuple[Callable[[bytes], int | None] | None, bool]:
    definition = topic.definition if topic.definition_encoding in _TEXTS else ""
    definition = definition or _definition_of(topic.message_type)
    stamp = stamp_reader(topic.message_type, definition, topic.encoding)
    fields = parse_definition(topic.message_type, definition)[plain_name(topic.message_type)]
    return stamp, stamp is not None and fields[0].type == "std_msgs/Header" and fields[0].length is None


def _frame(data: bytes) -> bytes:
    """Return the frame of a header: publishers often differ by it."""
    size = int.from_bytes(data[12:16], "little")
    return data[16 : 16 + size] if size < _LONGEST_FRAME_BYTES else b""


@cache
def _definition_of(name: str) -> str:
    """Return the definition of a ROS 2 type, with its parts; empty for others."""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - analyses of traces do not load it

    store = get_typestore(Stores.LATEST)
    return store.generate_msgdef(name)[0] if name in store.fielddefs else ""
