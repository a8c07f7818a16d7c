"""The messages of one recording, a file or a rosbag2 folder."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING

import zstandard

from dds_trace.base.errors import TraceFormatError

from ..format.bag_metadata import METADATA_NAME
from ..format.encoding import MAGIC
from ..mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from ..mcapfile.chunks import unpack_zstd
from ..mcapfile.file import MAX_RECORD_BYTES, RecordFile
from ..reading.recorded import LATEST_NS, Condition, RawMessage, RecordedTopic, UnreadableError
from ..reading.source import ZSTD_MAGIC
from ..reading.sqlite_pages import SQLITE_MAGIC
from ..reading.sqlite_rows import sqlite_messages
from .bag1 import BAG1_MAGIC, bag1_messages
from .mcap_walk import McapWalk, WalkedMessage
from .recording_files import missing_messages, open_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from mcap.records import Channel, Schema


def read_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    """Yield the messages of a recording; messages that it lacks by its own counts are in the damages of `condition`, complete at the end."""
    delivered = Counter[str]()
    with open_recording(path) as recording:
        condition.notes += recording.notes
        condition.damages += recording.damages
        for file, name in zip(recording.files, recording.names, strict=True):
            counts, about_file = Counter[str](), Condition()
            budget = _UnpackedBytes(file.stat().st_size)
            try:
                for message in _READERS[storage_kind(file)](file, about_file):
                    counts[message.topic.name] += 1
                    log_ns = max(min(message.log_ns, LATEST_NS), -LATEST_NS)
                    publish_ns = message.publish_ns if abs(message.publish_ns or 0) <= LATEST_NS else None
                    yield message._replace(log_ns=log_ns, publish_ns=publish_ns, data=budget.unpacked(message))
            except UnreadableError as err:
                raise TraceFormatError(name, f"the recording cannot be read on: {err}") from err
            finally:
                where = f"{name.name}: " if len(recording.files) > 1 else ""
                condition.damages += [f"{where}{damage}" for damage in about_file.damages]
                condition.notes += [f"{where}{note}" for note in about_file.notes]
                condition.chunks += about_file.chunks
                condition.topics |= about_file.topics
            if not about_file.damages:
                _compare(about_file.claimed, counts, name.name, condition)
            delivered += counts
        _compare(recording.claimed, delivered, METADATA_NAME, condition)
    if condition.damages and not delivered:
        raise TraceFormatError(path, f"the recording cannot be read: {condition.damages[0]}")


def _compare(claimed: Mapping[str, int], delivered: Mapping[str, int], who: str, condition: Condition) -> None:
    for topic, note in missing_messages(claimed, delivered, who):
        (condition.damages if delivered.get(topic, 0) < claimed[topic] else condition.notes).append(note)


class _UnpackedBytes:
    def __init__(self, size_bytes: int) -> None:
        self._room_bytes = most_unpacked_bytes(size_bytes)

    def unpacked(self, message: RawMessage) -> bytes:
        """Return the data; serialized CDR begins with a zero byte, so it is never taken for a zstd frame."""
        if message.topic.encoding != "cdr" or message.data[:4] != ZSTD_MAGIC:
            return message.data
        try:
            data = unpack_zstd(message.data, MAX_RECORD_BYTES + 1)
        except (zstandard.ZstdError, MemoryError):
            return message.data
        self._room_bytes -= len(data)
        if len(data) > MAX_RECORD_BYTES:
            raise UnreadableError(f"a piece of it unpacks to more than {MAX_RECORD_BYTES >> 20} MiB")
        if self._room_bytes < 0:
            raise UnreadableError(f"it unpacks to more than {LARGEST_FILE_RATIO} times its size")
        return data


def storage_kind(file: Path) -> str:
    """Return the suffix of a file's kind: by its first bytes, else by its name, else by a beginning further on."""
    with file.open("rb") as stream:
        start = stream.read(_SEARCHED_BYTES)
    kinds = [kind for magic, kind in _MAGICS.items() if start.startswith(magic)]
    kinds += [kind for kind in _READERS if file.suffix == kind]
    kinds += [kind for magic, kind in _MAGICS.items() if magic in start]
    if not kinds:
        raise UnreadableError("it is neither MCAP nor a ROS 1 bag nor a SQLite database")
    return kinds[0]


def _mcap_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    with closing(RecordFile(path)) as file:
        walk = McapWalk(file)
        topics: dict[int, tuple[Channel, RecordedTopic]] = {}
        try:
            for item in walk:
                if not isinstance(item, WalkedMessage):
                    continue
                declared = topics.get(item.channel.id)
                if declared is None or declared[0] is not item.channel:
                    declared = item.channel, _topic_of(item.channel, walk.schemas.get(item.channel.schema_id))
                    topics[item.channel.id] = declared
                yield RawMessage(declared[1], item.log_ns, item.publish_ns, item.sequence, item.data)
        finally:
            condition.damages += walk.damages
            condition.notes += walk.notes
            condition.chunks += walk.chunks
            condition.topics |= {
                _topic_of(channel, walk.schemas.get(channel.schema_id)) for channel in walk.channels.values()
            }
            for channel_id, count in walk.claims.items():
                if channel_id in walk.channels:
                    name = walk.channels[channel_id].topic
                    condition.claimed[name] = condition.claimed.get(name, 0) + count


def _topic_of(channel: Channel, schema: Schema | None) -> RecordedTopic:
    is_text = schema is not None and schema.encoding in TEXT_ENCODINGS
    return RecordedTopic(
        channel.topic,
        schema.name if schema else "",
        channel.message_encoding,
        schema.data.decode(errors="replace") if schema and is_text else "",
        schema.encoding if schema else "",
        channel.metadata.get("offered_qos_profiles", ""),
        channel.metadata.get("callerid", ""),
        channel.metadata.get("topic_type_hash", ""),
    )


TEXT_ENCODINGS = frozenset({"ros1msg", "ros2msg", "ros2idl", "omgidl", "jsonschema"})

_MAGICS = {MAGIC: ".mcap", BAG1_MAGIC: ".bag", SQLITE_MAGIC: ".db3"}
_SEARCHED_BYTES = 1 << 20

_READERS: dict[str, Callable[[Path, Condition], Iterator[RawMessage]]] = {
    ".mcap": _mcap_messages,
    ".bag": bag1_messages,
    ".db3": sqlite_messages,
}
