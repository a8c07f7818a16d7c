"""Messages of any recording (rosbag1, rosbag2, MCAP): topic, times, size and header stamp."""

from __future__ import annotations

import os
import re
import struct
from collections import Counter
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from mcap.records import Channel, Chunk, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME
from dds_trace.tracefile.mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from dds_trace.tracefile.mcapfile.chunks import unpack_records
from dds_trace.tracefile.mcapfile.file import MAX_RECORD_BYTES
from dds_trace.tracefile.reading.bag_bounds import bounded_unpacking
from dds_trace.tracefile.reading.recording_files import content_hash, missing_messages, open_recording
from dds_trace.tracefile.reading.source import unpack_message

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from rosbags.interfaces import Connection


_UNSUSPECTED_MESSAGES, _MESSAGE_BYTES = 2_000_000, 64
"""More messages than this, of fewer bytes each, are no recording but an attack."""

_SUFFIXES = (".mcap", ".bag", ".db3", ".mcap.zstd", ".db3.zstd")

LATEST_NS = 2**63 - 1
"""Latest time of a message that 64 bits with a sign hold (year 2262); MCAP has twice that."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a recording.

    `message_type` is empty if unknown; a topic `has_stamp` if its messages start with a header or a time.
    """

    name: str
    message_type: str
    encoding: str
    has_stamp: bool


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message; times in ns since 1970, or since boot if the recording has such times; None for one it lacks.

    Messages of unlike `content` are not copies of each other.
    """

    topic: Topic
    log_ns: int
    publish_ns: int | None
    stamp_ns: int | None
    payload_bytes: int
    content: int


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


def iter_messages(path: Path, notes: list[str] | None = None) -> Iterator[RecordedMessage]:
    """Yield the messages of one recording, file by file.

    What was delivered is compared with what the recording says it has (metadata.yaml, statistics of MCAP and SQLite); what is
    missing is added to `notes`.

    Raises:
        TraceFormatError: the path is not a recording, or ends early; complete messages before that were yielded.
    """
    notes = [] if notes is None else notes
    delivered = Counter[str]()
    with open_recording(path) as recording:
        notes += recording.notes
        for file in recording.files:
            of_file = Counter[str]()
            claims: dict[str, int] = {}
            messages = _mcap_messages(file, claims) if file.suffix == ".mcap" else _bag_messages(file, claims)
            for message in messages:
                of_file[message.topic.name] += 1
                yield message
            notes += missing_messages(claims, of_file, file.name)
            delivered += of_file
        notes += missing_messages(recording.claimed, delivered, METADATA_NAME)


def _mcap_messages(path: Path, claims: dict[str, int]) -> Iterator[RecordedMessage]:
    with path.open("rb") as file:
        try:
            yield from _mcap_stream(file, claims)
        except Exception as err:  # mcap and the codecs below it raise many kinds on damaged bytes
            raise TraceFormatError(path, f"the recording cannot be read on: {err}", file.tell()) from err


def _mcap_stream(file: BinaryIO, claims: dict[str, int]) -> Iterator[RecordedMessage]:
    """Yield the messages with `StreamReader`, which reads a truncated file up to its end."""
    schemas: dict[int, Schema] = {}
    topics: dict[int, tuple[Topic, Callable[[bytes], int | None]]] = {}
    size_bytes = os.fstat(file.fileno()).st_size
    unpacked_bytes, most_bytes = 0, most_unpacked_bytes(size_bytes)
    messages_left = _UNSUSPECTED_MESSAGES + size_bytes // _MESSAGE_BYTES
    for record in _mcap_records(file):
        if isinstance(record, Message):
            messages_left -= 1
            if messages_left < 0:
                raise ValueError("it has more messages than so few bytes hold")
            topic, stamp_of = topics[record.channel_id]
            data = unpack_message(record.data) if topic.encoding == "cdr" else record.data
            unpacked_bytes += len(data)
            if unpacked_bytes > most_bytes:
                raise ValueError(f"it unpacks to more than {LARGEST_FILE_RATIO} times its size")
            yield RecordedMessage(
                topic=topic,
                log_ns=_checked(record.log_time),
                publish_ns=_checked(record.publish_time),
                stamp_ns=stamp_of(data) if topic.has_stamp else None,
                payload_bytes=len(data),
                content=content_hash(data),
            )
        elif isinstance(record, Statistics):
            for channel_id, count in record.channel_message_counts.items():
                if channel_id in topics:
                    name = topics[channel_id][0].name
                    claims[name] = claims.get(name, 0) + count
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = schemas.get(record.schema_id)
            is_text = schema is not None and schema.encoding in {"ros1msg", "ros2msg"}
            text = schema.data.decode(errors="replace") if schema is not None and is_text else ""
            encoding = record.message_encoding
            topic = Topic(
                record.topic,
                schema.name if schema else "",
                encoding,
                begins_with_stamp(text) and encoding in _STAMP_READERS,
            )
            topics[record.id] = topic, _STAMP_READERS.get(encoding, _no_stamp)


def _mcap_records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of a file and, in their order, of its chunks, which are unpacked within bounds."""
    unpacked_bytes = 0
    for record in StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        unpacked_bytes += record.uncompressed_size
        if unpacked_bytes > most_unpacked_bytes(file.tell()):
            raise ValueError(f"it unpacks to more than {LARGEST_FILE_RATIO} times its size")
        data = unpack_records(record.compression, record.data, record.uncompressed_size)
        stream = BytesIO(data)
        # A chunk within a chunk stays packed.
        inner = iter(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
        while stream.tell() < len(data) and (inner_record := next(inner, None)) is not None:
            yield inner_record


def _bag_messages(path: Path, claims: dict[str, int]) -> Iterator[RecordedMessage]:
    """Yield the messages through rosbags, which reads all storages but only the log time."""
    try:
        with (
            bounded_unpacking(path) as unpack,
            AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader,
        ):
            encoding = "cdr" if reader.is2 else "ros1"
            topics = {
                (id(c.owner), c.id): Topic(c.topic, c.msgtype, encoding, _connection_has_stamp(c))
                for c in reader.connections
            }
            for connection in reader.connections if reader.is2 else ():
                claims[connection.topic] = claims.get(connection.topic, 0) + connection.msgcount
            for connection, log_ns, packed in reader.messages():
                data = unpack(packed) if reader.is2 else packed
                topic = topics[id(connection.owner), connection.id]
                stamp_ns = _STAMP_READERS[encoding](bytes(data[:24])) if topic.has_stamp else None
                yield RecordedMessage(topic, _checked(log_ns), None, stamp_ns, len(data), content_hash(data))
    except Exception as err:  # so do rosbags and SQLite
        raise TraceFormatError(path, f"the recording cannot be read on: {err}") from err


def _checked(time_ns: int) -> int:
    if not -LATEST_NS <= time_ns <= LATEST_NS:
        raise ValueError(f"{time_ns} ns is not a time")
    return time_ns


def _connection_has_stamp(connection: Connection) -> bool:
    if connection.msgdef.format == MessageDefinitionFormat.MSG:
        return begins_with_stamp(connection.msgdef.data)
    return connection.msgtype in _stamped_types()


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
