"""The messages of one recording, a file or a rosbag2 folder."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from mcap.opcode import Opcode
from mcap.records import Attachment, Header, Metadata, Statistics

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted

from ..format.bag_metadata import METADATA_NAME
from ..format.encoding import MAGIC, MESSAGE_HEADER
from ..mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from ..mcapfile.file import MAX_RECORD_BYTES, RecordFile
from ..mcapfile.records import parse_record, record_name
from ..reading.mcap_walk import McapWalk
from ..reading.recorded import LATEST_NS, Budget, Condition, RawMessage, RecordedTopic, UnreadableError
from ..reading.source import unpack_message
from ..reading.sqlite_pages import SQLITE_MAGIC
from ..reading.sqlite_rows import sqlite_messages
from .bag1 import BAG1_MAGIC, bag1_messages
from .recording_files import open_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from mcap.records import Channel

    from ..mcapfile.blocks import Block, Record
    from ..mcapfile.channels import ChannelTable, DeclaredChannel
    from ..mcapfile.chunks import PackedChunk


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
                for topic, log_ns, publish_ns, sequence, data in _READERS[storage_kind(file)](file, about_file):
                    counts[topic.name] += 1
                    log_within_ns = max(min(log_ns, LATEST_NS), -LATEST_NS)
                    publish_within_ns = publish_ns if abs(publish_ns or 0) <= LATEST_NS else None
                    unpacked = budget.unpacked(data) if topic.encoding == "cdr" else data
                    yield RawMessage(topic, log_within_ns, publish_within_ns, sequence, unpacked)
            except UnreadableError as err:
                raise TraceFormatError(name, f"the recording cannot be read further: {err}") from err
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
    for topic, count in claimed.items():
        got = delivered.get(topic, 0)
        if got != count:
            read = f"{got} {'was' if got == 1 else 'were'} read"
            note = f"{who} says that {topic} has {counted(count, 'message')}, {read}"
            (condition.damages if got < count else condition.notes).append(note)


class _UnpackedBytes:
    def __init__(self, size_bytes: int) -> None:
        self._room_bytes = most_unpacked_bytes(size_bytes)

    def unpacked(self, packed: bytes) -> bytes:
        data = unpack_message(packed, MAX_RECORD_BYTES + 1)
        if data is packed:
            return data
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


class WalkedMessage(NamedTuple):
    channel: Channel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


Item: TypeAlias = "WalkedMessage | Attachment | Metadata"


class McapItems:
    """One-time iterable of the items of a file, in file order; messages out of damaged chunks are `doubtful`, others without a checksum `unchecked`."""

    def __init__(self, file: RecordFile) -> None:
        self.walk = McapWalk(file)
        self.channels = self.walk.channels
        self.header: Header | None = self.walk.header
        self.claims: dict[int, int] = {}
        self.chunks: list[tuple[int, int, int]] = []
        self.doubtful = 0
        self.unchecked = 0
        self._budget = Budget(file.size)
        self._undeclared = Counter[int]()
        self._impossible = 0

    def __iter__(self) -> Iterator[Item]:
        for block in self.walk:
            for chunk, records in block.parts():
                yield from self._items(block, chunk, records)
        for channel_id, count in self._undeclared.items():
            self.walk.damages.append(f"{counted(count, 'message')} of channel {channel_id}: its declaration is lost")
        if self._impossible:
            impossible = counted(self._impossible, "message has a time", "messages have times")
            self.walk.damages.append(f"{impossible} that no clock shows (after the year 2262)")

    def _items(self, block: Block, chunk: PackedChunk | None, records: list[Record]) -> Iterator[Item]:
        data, header_bytes, times_ns, get = block.data, MESSAGE_HEADER.size, list[int](), self.channels.get
        for opcode, start, length in records:
            if opcode != Opcode.MESSAGE:
                yield from self._other(opcode, bytes(data[start : start + length]), block.offset(start))
                continue
            if length < header_bytes:
                continue
            channel_id, sequence, log_ns, publish_ns = MESSAGE_HEADER.unpack_from(data, start)
            self._budget.take()
            self._impossible += log_ns > LATEST_NS or publish_ns > LATEST_NS
            declared = get(channel_id) or self._declared_later(channel_id)
            if chunk is not None:
                times_ns.append(log_ns)
            elif declared is not None and self.walk.is_near(log_ns):
                self.walk.saw(log_ns, log_ns)
            if declared is None:
                self._undeclared[channel_id] += 1
                continue
            self.doubtful += block.is_doubtful
            self.unchecked += not block.is_doubtful and not (chunk and chunk.crc)
            content = bytes(data[start + header_bytes : start + length])
            yield WalkedMessage(declared.record, sequence, log_ns, publish_ns, content)
        possible_ns = [time_ns for time_ns in times_ns if time_ns <= LATEST_NS]
        if possible_ns:
            self.chunks.append((min(possible_ns), max(possible_ns), len(times_ns)))
            self.walk.saw(min(possible_ns), max(possible_ns))

    def _declared_later(self, channel_id: int) -> DeclaredChannel | None:
        self.walk.look_ahead()
        return self.channels.get(channel_id)

    def _other(self, opcode: int, content: bytes, offset: int) -> Iterator[Item]:
        try:
            if opcode == Opcode.HEADER:
                self.header = self.header or parse_record(Header, content)
            elif opcode == Opcode.STATISTICS:
                self.claims = parse_record(Statistics, content).channel_message_counts
            elif opcode == Opcode.ATTACHMENT:
                yield parse_record(Attachment, content)
            elif opcode == Opcode.METADATA:
                yield parse_record(Metadata, content)
            else:
                self.walk.declare(opcode, content, offset)
        except ValueError as err:
            self.walk.damages.append(f"the {record_name(opcode)} record at byte {offset} is damaged ({err})")


def _mcap_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    with closing(RecordFile(path)) as file:
        items = McapItems(file)
        topics: dict[int, tuple[Channel, RecordedTopic]] = {}
        try:
            for item in items:
                if not isinstance(item, WalkedMessage):
                    continue
                channel = item.channel
                declared = topics.get(channel.id)
                if declared is None or declared[0] is not channel:
                    declared = topics[channel.id] = channel, topic_of(channel, items.channels)
                yield RawMessage(declared[1], item.log_ns, item.publish_ns, item.sequence, item.data)
        finally:
            condition.damages += items.walk.damages
            condition.notes += items.walk.notes
            condition.chunks += items.chunks
            condition.topics |= {
                topic_of(declaration.record, items.channels) for _, declaration in items.channels.items()
            }
            claims = [(items.channels.get(channel_id), count) for channel_id, count in items.claims.items()]
            for topic, count in [(declaration.topic, count) for declaration, count in claims if declaration]:
                condition.claimed[topic] = condition.claimed.get(topic, 0) + count


def topic_of(channel: Channel, declared: ChannelTable) -> RecordedTopic:
    schema = declared.schemas.get(channel.schema_id)
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
