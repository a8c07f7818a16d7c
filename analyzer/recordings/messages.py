"""Messages of any recording (rosbag1, rosbag2, MCAP): topic, times, size and header stamp."""

from __future__ import annotations

import os
import re
import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from rosbags.typesys import Stores, get_typestore

from dds_trace.base.errors import MissingEventsError
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME
from dds_trace.tracefile.recordings.read import read_messages
from dds_trace.tracefile.recordings.recorded import Condition
from dds_trace.tracefile.recordings.recording_files import content_hash

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from dds_trace.tracefile.recordings.recorded import RecordedTopic

_LONGEST_FRAME_BYTES = 256

_SUFFIXES = (".mcap", ".bag", ".bag.active", ".db3", ".mcap.zstd", ".db3.zstd")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a recording.

    `message_type` is empty if unknown; a topic `has_stamp` if its messages start with a header or a time; `qos` as recorded.
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
    topics: dict[RecordedTopic, Topic] = {}
    for raw in read_messages(path, Condition() if condition is None else condition):
        topic = topics.get(raw.topic)
        if topic is None:
            topic = topics[raw.topic] = _topic_of(raw.topic)
        data = raw.data
        stamp_ns, frame, sequence = None, 0, raw.sequence
        if topic.has_stamp:
            stamp_ns = _STAMP_READERS[topic.encoding](data[:24])
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


def _topic_of(topic: RecordedTopic) -> Topic:
    has_stamp = topic.encoding in _STAMP_READERS and (
        begins_with_stamp(topic.definition) if topic.definition else topic.message_type in _stamped_types()
    )
    return Topic(topic.name, topic.message_type, topic.encoding, has_stamp, topic.qos)


def _frame(data: bytes) -> bytes:
    """Return the frame of a header: publishers of one topic often differ by it."""
    size = int.from_bytes(data[12:16], "little")
    return data[16 : 16 + size] if size < _LONGEST_FRAME_BYTES else b""


@cache
def _stamped_types() -> frozenset[str]:
    types = get_typestore(Stores.LATEST).fielddefs.items()
    return frozenset(name for name, (_, fields) in types if fields and fields[0][1][1] == "std_msgs/msg/Header")


_COMMENT_OR_CONSTANT = re.compile(r"\s*(#.*)?|\s*[^#\s]+\s+\w+\s*=.*")
_STAMPED = re.compile(r"\s*((std_msgs/(msg/)?)?Header\s+\w+|builtin_interfaces/(msg/)?Time\s+\w+)\s*(#.*)?")


def begins_with_stamp(definition: str) -> bool:
    """Return whether the first field in the text of a `.msg` file is a `std_msgs/Header` or a time."""
    for line in definition.splitlines():
        if line.startswith("==="):
            return False
        if not _COMMENT_OR_CONSTANT.fullmatch(line):
            return _STAMPED.fullmatch(line) is not None
    return False


_CDR_ORDER = {0: ">", 1: "<", 6: ">", 7: "<"}
"""Byte order by the second byte of the encapsulation: plain CDR, version 1 and 2 (OMG DDS-XTypes 1.3, 7.6.3.1.2)."""


def _cdr_stamp(data: bytes) -> int | None:
    if len(data) < 12 or data[0] or data[1] not in _CDR_ORDER:
        return None
    seconds, nanoseconds = struct.unpack_from(f"{_CDR_ORDER[data[1]]}iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds or None


def _ros1_stamp(data: bytes) -> int | None:
    if len(data) < 12:
        return None
    seconds, nanoseconds = struct.unpack_from("<II", data, 4)  # after the sequence number
    return seconds * 1_000_000_000 + nanoseconds or None


def _no_stamp(_: bytes) -> None:
    return None


_STAMP_READERS: dict[str, Callable[[bytes], int | None]] = {"cdr": _cdr_stamp, "ros1": _ros1_stamp}
