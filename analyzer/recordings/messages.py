"""Messages of any recording (rosbag1, rosbag2, MCAP): topic, times, size and header stamp."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

from rosbags.typesys import Stores, get_typestore

from dds_trace.base.errors import MissingEventsError
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME
from dds_trace.tracefile.format.header_stamps import parse_definition, plain_name, stamp_reader
from dds_trace.tracefile.recordings.read import read_messages
from dds_trace.tracefile.recordings.recorded import Condition, RecordedTopic
from dds_trace.tracefile.recordings.recording_files import content_hash

_LONGEST_FRAME_BYTES = 256

_TEXTS = ("ros1msg", "ros2msg")

_SUFFIXES = (".mcap", ".bag", ".bag.active", ".db3", ".mcap.zstd", ".db3.zstd")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a recording.

    `message_type` is empty if unknown; a topic `has_stamp` if its messages have a header, at any depth, or start with a time; `qos` as recorded.
    """

    name: str
    message_type: str
    encoding: str
    has_stamp: bool
    qos: str = ""


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message; times in ns since 1970, or since boot if the recording has such times; None for one it lacks.

    Messages of unlike `content` are not copies of each other. Publishers of one topic differ by `publisher` (rosbag1) or by the `frame`
    of their headers, where they do.
    """

    topic: Topic
    log_ns: int
    publish_ns: int | None
    stamp_ns: int | None
    payload_bytes: int
    content: int
    sequence: int | None
    publisher: int
    frame: int
    data: bytes


def find_recordings(path: str | os.PathLike[str], *, skip: Collection[str | os.PathLike[str]] = ()) -> list[Path]:
    """Find all `.mcap`, `.bag` and `.db3` files and rosbag2 folders in a folder and below it, sorted; or the path itself.

    Raises:
        MissingEventsError: there is no such file or folder.
    """
    path, skipped = Path(path), {Path(other).resolve() for other in skip}
    if path.is_file() or (path / METADATA_NAME).is_file():
        return [path]
    if not path.is_dir():
        raise MissingEventsError(f"{path}: no such file or folder")
    recordings: list[Path] = []
    for name, folders, files in os.walk(path):
        here = Path(name)
        if here.resolve() in skipped:
            folders.clear()
        elif METADATA_NAME in files:
            recordings.append(here)
            folders.clear()
        else:
            unpacked = set(files)
            recordings += [
                here / file
                for file in files
                if file.endswith(_SUFFIXES) and not (file.endswith(".zstd") and file[:-5] in unpacked)
            ]
    return sorted(recordings)


def iter_messages(path: Path, condition: Condition | None = None) -> Iterator[RecordedMessage]:
    """Yield the messages of one recording, file by file; what was found broken is added to `condition`.

    Raises:
        TraceFormatError: the path is not a recording, or its reading ends early; messages before that were yielded.
    """
    readers: dict[RecordedTopic, _Readers] = {}
    for raw in read_messages(path, Condition() if condition is None else condition):
        if raw.topic not in readers:
            readers[raw.topic] = _readers_of(raw.topic)
        topic, stamp, begins_with_header = readers[raw.topic]
        data = raw.data
        stamp_ns, frame, sequence = stamp(data) if stamp else None, 0, raw.sequence
        if begins_with_header:
            frame = hash(_frame(data))
            if topic.encoding == "ros1":
                sequence = int.from_bytes(data[:4], "little")
        yield RecordedMessage(
            topic,
            raw.log_ns,
            raw.publish_ns,
            stamp_ns,
            len(data),
            content_hash(data),
            sequence,
            hash(raw.topic.publisher),
            frame,
            data,
        )


class _Readers(NamedTuple):
    """A topic, how its stamp is read, and whether its messages begin with a header."""

    topic: Topic
    stamp: Callable[[bytes], int | None] | None
    begins_with_header: bool


def _readers_of(topic: RecordedTopic) -> _Readers:
    definition = topic.definition if topic.definition_encoding in _TEXTS else ""
    definition = definition or _definition_of(topic.message_type)
    stamp = stamp_reader(topic.message_type, definition, topic.encoding)
    fields = parse_definition(topic.message_type, definition)[plain_name(topic.message_type)]
    begins = stamp is not None and fields[0].type == "std_msgs/Header" and fields[0].length is None
    return _Readers(Topic(topic.name, topic.message_type, topic.encoding, stamp is not None, topic.qos), stamp, begins)


def _frame(data: bytes) -> bytes:
    """Return the frame of a header: publishers of one topic often differ by it."""
    size = int.from_bytes(data[12:16], "little")
    return data[16 : 16 + size] if size < _LONGEST_FRAME_BYTES else b""


@cache
def _definition_of(name: str) -> str:
    """Return the definition of a type that ROS 2 itself has, with those that it is made of; empty for others."""
    store = get_typestore(Stores.LATEST)
    return store.generate_msgdef(name)[0] if name in store.fielddefs else ""
