"""The messages of one recording, a file or a rosbag2 folder."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from mcap.opcode import Opcode
from mcap.records import Attachment, Header, Metadata, Statistics

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import open_regular
from dds_trace.base.units import counted
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME, RecordedTopic
from dds_trace.tracefile.format.encoding import MAGIC, MESSAGE_HEADER
from dds_trace.tracefile.mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from dds_trace.tracefile.mcapfile.file import MAX_RECORD_BYTES, RecordFile
from dds_trace.tracefile.mcapfile.records import parse_record, record_name, topic_of
from dds_trace.tracefile.reading.mcap_walk import McapWalk
from dds_trace.tracefile.reading.source import LATEST_NS, Budget, Condition, RawMessage, UnreadableError, unpack_message
from dds_trace.tracefile.reading.storage import ZSTD_SUFFIX, storage_files, unpacked

from .bag1 import BAG1_MAGIC, bag1_messages
from .sqlite_pages import SQLITE_MAGIC
from .sqlite_rows import sqlite_messages

if TYPE_CHECKING:
    from collections.abc import Callable

    from mcap.records import Channel

    from dds_trace.tracefile.mcapfile.blocks import Block, Record
    from dds_trace.tracefile.mcapfile.chunks import PackedChunk


_MOST_METADATA_BYTES = 16 << 20
"""A thousand topics with the QoS of ten publishers each have 6 MB."""


@dataclass(slots=True)
class RecordingFiles:
    """The files, each as it can be read, with the names that they have."""

    files: list[Path]
    names: list[Path]
    damages: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    claimed: Mapping[str, int] = field(default_factory=dict)


@contextmanager
def open_recording(path: Path) -> Iterator[RecordingFiles]:
    """Yield the files of a recording, packed ones as temporary copies."""
    recording = _described(path) if path.is_dir() else RecordingFiles([path], [path])
    with ExitStack() as stack:
        copies = (unpacked(file, LARGEST_FILE_RATIO, most_unpacked_bytes(0)) for file in recording.files)
        recording.files = [stack.enter_context(copy) for copy in copies]
        yield recording


_HASHED_BYTES = 4096


def content_hash(data: bytes) -> int:
    return hash((len(data), bytes(data[:_HASHED_BYTES]), bytes(data[-_HASHED_BYTES:])))


def copied_messages(topic: str, copies: int) -> Iterator[str]:
    if copies:
        yield f"{counted(copies, 'message')} of {topic} {'is' if copies == 1 else 'are'} there twice (same time and bytes): a merged bag, or a reset?"


def _described(folder: Path) -> RecordingFiles:
    stored = storage_files(folder)
    listed, claimed = _read_metadata(folder / METADATA_NAME)
    if not listed:
        return RecordingFiles(stored, stored[:], claimed=claimed)
    names = {name.removesuffix(ZSTD_SUFFIX) for name in listed}
    files = [file for file in stored if file.name.removesuffix(ZSTD_SUFFIX) in names]
    missing = sorted(names - {file.name.removesuffix(ZSTD_SUFFIX) for file in files})
    unlisted = [file for file in stored if file not in files]
    if len(missing) == len(unlisted) == 1:
        note = f"{unlisted[0].name} is not listed in {METADATA_NAME} and is read as {missing[0]}, which is not here: renamed?"
        return RecordingFiles(stored, stored[:], notes=[note], claimed=claimed)
    damages = [f"{name} is listed in {METADATA_NAME} but is not here" for name in missing]
    notes = [f"{file.name} is not listed in {METADATA_NAME} and was not read" for file in unlisted]
    if not files:
        raise TraceFormatError(folder, "; ".join([*damages, *notes][:3]))
    return RecordingFiles(files, files[:], damages, notes, claimed)


def _read_metadata(path: Path) -> tuple[list[str], dict[str, int]]:
    """Return the listed files and the messages of each topic, nothing where the file cannot be read."""
    try:
        with open_regular(path) as file:
            text = file.read(_MOST_METADATA_BYTES).decode(errors="replace")
    except OSError:
        return [], {}
    listed: list[str] = []
    claimed: dict[str, int] = {}
    section, section_indent = "", 0
    name, count = None, None
    for line in text.splitlines():
        key = _KEY.match(line)
        if key and len(key["indent"]) <= section_indent and not key["item"]:
            section = ""
        if key and not section and key["key"] in {"relative_file_paths", "topics_with_message_count"}:
            section, section_indent = key["key"], len(key["indent"])
        elif section == "relative_file_paths" and (item := _ITEM.match(line)):
            listed.append(Path(_plain(item[1])).name)
        elif section == "topics_with_message_count" and key:
            if key["key"] == "name":
                name = _plain(key["value"])
            elif key["key"] == "message_count" and _COUNT.fullmatch(key["value"].strip()):
                count = int(key["value"])
            if name is not None and count is not None:
                claimed[name] = claimed.get(name, 0) + count
                name, count = None, None
    return listed, claimed


_KEY = re.compile(r"(?P<indent> *)(?P<item>- )? *(?P<key>\w+):(?P<value>.*)")
_ITEM = re.compile(r" *- +(.+)")
_COUNT = re.compile(r"\d{1,18}")


def _plain(text: str) -> str:
    text = text.strip()
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text


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


Item: TypeAlias = "tuple[Channel, RawMessage] | Attachment | Metadata"


class McapItems:
    """One-time iterable of the items of a file, in file order; messages out of damaged chunks are `doubtful`, others without a checksum `unchecked`."""

    def __init__(self, file: RecordFile) -> None:
        self.walk = McapWalk(file)
        self.channels = self.walk.channels
        self.header: Header | None = self.walk.header
        self.claims: dict[int, int] = {}
        self.chunks: list[tuple[int, int, int]] = []
        self.topics: set[RecordedTopic] = set()
        self._topics: dict[int, tuple[Channel, RecordedTopic]] = {}
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
            declared = get(channel_id)
            if declared is None:
                self.walk.look_ahead()
                declared = get(channel_id)
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
            channel, topic = self._topics.get(channel_id, (None, None))
            if topic is None or channel is not declared.record:
                topic = topic_of(declared.record, self.channels.schemas)
                self._topics[channel_id] = declared.record, topic
                self.topics.add(topic)
            yield declared.record, RawMessage(topic, log_ns, publish_ns, sequence, content)
        possible_ns = [time_ns for time_ns in times_ns if time_ns <= LATEST_NS]
        if possible_ns:
            self.chunks.append((min(possible_ns), max(possible_ns), len(times_ns)))
            self.walk.saw(min(possible_ns), max(possible_ns))

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
        try:
            for item in items:
                if isinstance(item, tuple):
                    yield item[1]
        finally:
            condition.damages += items.walk.damages
            condition.notes += items.walk.notes
            condition.chunks += items.chunks
            names = {topic.name for topic in items.topics}
            silent = [declared.record for _, declared in items.channels.items() if declared.topic not in names]
            condition.topics |= items.topics | {topic_of(channel, items.channels.schemas) for channel in silent}
            claims = [(items.channels.get(channel_id), count) for channel_id, count in items.claims.items()]
            for topic, count in [(declaration.topic, count) for declaration, count in claims if declaration]:
                condition.claimed[topic] = condition.claimed.get(topic, 0) + count


_MAGICS = {MAGIC: ".mcap", BAG1_MAGIC: ".bag", SQLITE_MAGIC: ".db3"}
_SEARCHED_BYTES = 1 << 20

_READERS: dict[str, Callable[[Path, Condition], Iterator[RawMessage]]] = {
    ".mcap": _mcap_messages,
    ".bag": bag1_messages,
    ".db3": sqlite_messages,
}
