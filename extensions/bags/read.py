"""The messages of one recording, a file or a rosbag2 folder."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias
from urllib.parse import quote, unquote

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Statistics
from numpy.typing import NDArray

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import open_regular
from dds_trace.base.units import counted
from dds_trace.tracefile.format.bag_metadata import METADATA_NAME, RecordedTopic
from dds_trace.tracefile.format.encoding import MESSAGE_FIELDS, MESSAGE_HEADER, RECORD_HEADER
from dds_trace.tracefile.mcapfile.blocks import LARGEST_FILE_RATIO, Block, most_unpacked_bytes
from dds_trace.tracefile.mcapfile.chunks import PackedChunk
from dds_trace.tracefile.mcapfile.file import MAX_RECORD_BYTES, RecordFile
from dds_trace.tracefile.mcapfile.records import parse_record, record_name, topic_of
from dds_trace.tracefile.mcapfile.scan import lengths_at, unaligned
from dds_trace.tracefile.reading.mcap_walk import McapWalk
from dds_trace.tracefile.reading.source import ZSTD_MAGIC, Budget, UnreadableError, unpack_message
from dds_trace.tracefile.reading.storage import ZSTD_SUFFIX, storage_files, unpacked

from .kinds import BLOCK_BYTES, MOST_TEXT_BYTES, RECORDING_KINDS, SQLITE_MAGIC, RecordingKind, function_at
from .recorded import LATEST_NS, NONE, Condition, Int64, MessageBatch, RawMessage, batched

REMAINDER = "dds_trace_recovered"
"""Name of the mark of a copy from a damaged recording: `/topic=messages` that this counted and lacks."""
REMAINDER_ID = b"ddsr"
"""Application id of a database that is such a copy."""
_SQLITE_ID = slice(68, 72)
UNCOUNTED = "what the damage took is counted nowhere"


@dataclass(slots=True)
class RecordingFiles:
    """The files, each as it can be read, with the names that they have; what was found of the folder."""

    files: list[Path]
    names: list[Path]
    condition: Condition


@contextmanager
def open_recording(path: Path) -> Iterator[RecordingFiles]:
    recording = _described(path) if path.is_dir() else RecordingFiles([path], [path], Condition())
    with ExitStack() as stack:
        copies = (unpacked(file, LARGEST_FILE_RATIO, most_unpacked_bytes(0)) for file in recording.files)
        recording.files = [stack.enter_context(copy) for copy in copies]
        yield recording


def copied_messages(topic: str, copies: int) -> Iterator[str]:
    if copies:
        yield f"{counted(copies, 'message')} of {topic} {'is' if copies == 1 else 'are'} there twice (same time and bytes): a merged bag, or a reset?"


def _described(folder: Path) -> RecordingFiles:
    stored, text = storage_files(folder), ""
    with suppress(OSError), open_regular(folder / METADATA_NAME) as file:
        text = file.read(MOST_TEXT_BYTES).decode(errors="replace")
    listed, claimed = _read_metadata(text)
    mark = _MARK.search(text)
    described = Condition(claimed=claimed, is_remainder=mark is not None, gone=gone_of(_plain(mark[1]) if mark else ""))
    if not listed:
        return RecordingFiles(stored, stored[:], described)
    names = {name.removesuffix(ZSTD_SUFFIX) for name in listed}
    files = [file for file in stored if file.name.removesuffix(ZSTD_SUFFIX) in names]
    missing = sorted(names - {file.name.removesuffix(ZSTD_SUFFIX) for file in files})
    unlisted = [file for file in stored if file not in files]
    if len(missing) == len(unlisted) == 1:
        note = f"{unlisted[0].name} is not listed in {METADATA_NAME} and is read as {missing[0]}, which is not here: renamed?"
        described.notes.append(note)
        return RecordingFiles(stored, stored[:], described)
    described.damages = [f"{name} is listed in {METADATA_NAME} but is not here" for name in missing]
    described.notes = [f"{file.name} is not listed in {METADATA_NAME} and was not read" for file in unlisted]
    if not files:
        raise TraceFormatError(folder, "; ".join([*described.damages, *described.notes][:3]))
    return RecordingFiles(files, files[:], described)


def _read_metadata(text: str) -> tuple[list[str], dict[str, int]]:
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


def mark_of(gone: Mapping[str, int]) -> str:
    return " ".join(f"{quote(topic)}={count}" for topic, count in gone.items())


def gone_of(mark: str) -> Counter[str]:
    return Counter({unquote(topic): int(count) for topic, count in _GONE.findall(mark)})


_MARK = re.compile(rf"^ +{REMAINDER}:(.*)", re.MULTILINE)
_GONE = re.compile(r"(\S+)=(\d{1,12})(?!\S)")
_KEY = re.compile(r"(?P<indent> *)(?P<item>- )? *(?P<key>\w+):(?P<value>.*)")
_ITEM = re.compile(r" *- +(.+)")
_COUNT = re.compile(r"\d{1,18}")


def _plain(text: str) -> str:
    text = text.strip()
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text


def read_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    for batch in read_batches(path, condition):
        yield from batch.messages()


def read_batches(path: Path, condition: Condition) -> Iterator[MessageBatch]:
    """Yield the messages of a recording, of all batches with indices in one growing list of topics.

    Messages that it lacks by its own counts are in the damages of `condition`, complete at the end.
    """
    delivered, index_of, topics = Counter[str](), dict[RecordedTopic, int](), list[RecordedTopic]()
    with open_recording(path) as recording:
        described = recording.condition
        condition.notes += described.notes
        condition.damages += described.damages
        condition.is_remainder |= described.is_remainder
        for file, name in zip(recording.files, recording.names, strict=True):
            counts, about_file = Counter[str](), Condition()
            budget, indices = _UnpackedBytes(file.stat().st_size), list[int]()
            last_topics: Sequence[RecordedTopic] = ()
            try:
                for batch in function_at(kind_of(file).read)(file, about_file):
                    indices = indices if batch.topics is last_topics else []
                    last_topics = batch.topics
                    for topic in batch.topics[len(indices) :]:
                        indices.append(index_of.setdefault(topic, len(topics)))
                        topics += [topic] * (indices[-1] == len(topics))
                    for index, count in enumerate(np.bincount(batch.topic).tolist()):
                        counts[batch.topics[index].name] += count
                    numbered = replace(batch, topics=topics, topic=np.array(indices, np.int64)[batch.topic])
                    yield from budget.unpacked(numbered)
            except UnreadableError as err:
                raise TraceFormatError(name, f"the recording cannot be read further: {err}") from err
            finally:
                if file.suffix == ".bag" and ".recovered." in name.name:
                    about_file.notes.append(f"recovered, by its name: {UNCOUNTED}")
                condition.is_remainder |= about_file.is_remainder or is_remainder(file)
                condition.gone += about_file.gone
                where = f"{name.name}: " if len(recording.files) > 1 else ""
                condition.damages += [f"{where}{damage}" for damage in about_file.damages]
                condition.notes += [f"{where}{note}" for note in about_file.notes]
                condition.chunks += about_file.chunks
                condition.topics |= about_file.topics
            if not about_file.damages:
                _compare(about_file.claimed, counts, name.name, condition)
            delivered += counts
        condition.gone |= described.gone
        _compare(described.claimed, delivered, METADATA_NAME, condition)
    if condition.damages and not delivered:
        raise TraceFormatError(path, f"the recording cannot be read: {condition.damages[0]}")


def is_remainder(database: Path) -> bool:
    with database.open("rb") as stream:
        head = stream.read(_SQLITE_ID.stop)
    return head.startswith(SQLITE_MAGIC) and head[_SQLITE_ID] == REMAINDER_ID


def _compare(claimed: Mapping[str, int], delivered: Mapping[str, int], who: str, condition: Condition) -> None:
    for topic, count in claimed.items():
        got = delivered.get(topic, 0)
        if got != count:
            read = f"{got:,} {'was' if got == 1 else 'were'} read"
            note = f"{who} says that {topic} has {counted(count, 'message')}, {read}"
            (condition.damages if got < count else condition.notes).append(note)


class _UnpackedBytes:
    def __init__(self, size_bytes: int) -> None:
        self._room_bytes = most_unpacked_bytes(size_bytes)

    def unpacked(self, batch: MessageBatch) -> Iterator[MessageBatch]:
        has_start = batch.sizes >= len(ZSTD_MAGIC)
        is_packed = unaligned(batch.data, "<u4")[batch.starts[has_start]] == int.from_bytes(ZSTD_MAGIC, "little")
        if not is_packed.any():
            yield batch
            return
        first = 0
        for part in batched(map(self._unpacked, batch.messages())):
            yield replace(part, topics=batch.topics, topic=batch.topic[first : first + len(part)])
            first += len(part)

    def _unpacked(self, message: RawMessage) -> RawMessage:
        data = unpack_message(message.data, MAX_RECORD_BYTES + 1) if message.topic.encoding == "cdr" else message.data
        if data is message.data:
            return message
        self._room_bytes -= len(data)
        if len(data) > MAX_RECORD_BYTES:
            raise UnreadableError(f"a piece of it unpacks to more than {MAX_RECORD_BYTES >> 20} MiB")
        if self._room_bytes < 0:
            raise UnreadableError(f"it unpacks to more than {LARGEST_FILE_RATIO} times its size")
        return message._replace(data=data)


def kind_of(file: Path) -> RecordingKind:
    """Return the kind of a file: by its first bytes, else by its name, else by a beginning further on."""
    with file.open("rb") as stream:
        start = stream.read(BLOCK_BYTES)
    kinds = [kind for kind in RECORDING_KINDS if start.startswith(kind.magic)]
    kinds += [kind for kind in RECORDING_KINDS if file.suffix == kind.suffix]
    kinds += [kind for kind in RECORDING_KINDS if kind.magic in start]
    if not kinds:
        raise UnreadableError(f"it is neither {' nor '.join(kind.name for kind in RECORDING_KINDS)}")
    return kinds[0]


Item: TypeAlias = "MessageBatch | Attachment | Metadata"


class McapItems:
    """One-time iterable of the items of a file, in file order; messages out of damaged chunks are `doubtful`, others without a checksum `unchecked`.

    `records` has the channel of each topic of a batch.
    """

    def __init__(self, file: RecordFile) -> None:
        self.walk = McapWalk(file)
        self.channels = self.walk.channels
        self.header: Header | None = self.walk.header
        self.claims: dict[int, int] = {}
        self.chunks: list[tuple[int, int, int]] = []
        self.topics: list[RecordedTopic] = []
        self.records: list[Channel] = []
        self._index_of: dict[int, int] = {}
        self._indices = np.full(np.iinfo(np.uint16).max + 1, -1, np.int64)
        self._indices_are_of = -1
        self.doubtful = 0
        self.unchecked = 0
        self._budget = Budget(file.size)
        self._undeclared = Counter[int]()
        self._impossible = 0

    def __iter__(self) -> Iterator[Item]:
        for block in self.walk:
            yield from self._items(block)
        for channel_id, count in self._undeclared.items():
            self.walk.damages.append(f"{counted(count, 'message')} of channel {channel_id}: its declaration is lost")
        if self._impossible:
            impossible = counted(self._impossible, "message has a time", "messages have times")
            self.walk.damages.append(f"{impossible} that no clock shows (after the year 2262)")

    def _items(self, block: Block) -> Iterator[Item]:
        starts = block.scan.message_starts()
        sizes = lengths_at(block.data, starts) - MESSAGE_HEADER.size
        if len(sizes) and sizes.min() < 0:
            starts, sizes = starts[sizes >= 0], sizes[sizes >= 0]
        count = self._budget.take(len(starts))
        is_beyond, starts, sizes = count < len(starts), starts[:count], sizes[:count]
        at = starts + RECORD_HEADER.size
        times_ns, channel_ids = unaligned(block.data, "<i8"), unaligned(block.data, "<u2")[at]
        log_ns, publish_ns = (times_ns[at + MESSAGE_FIELDS[name]] for name in ("log_time", "publish_time"))
        topic, first = np.empty(count, np.int64), 0
        for opcode, start, length in block.scan.others:
            content = bytes(block.data[start : start + length])
            if opcode not in {Opcode.SCHEMA, Opcode.CHANNEL}:
                yield from self._other(opcode, content, block.offset(start))
                continue
            until = int(np.searchsorted(starts, start))
            if until > first and self.channels.would_change(opcode, content):
                topic[first:until] = self._topics_of(channel_ids[first:until])
                first = until
            self.walk.declare(opcode, content, block.offset(start))
        topic[first:] = self._topics_of(channel_ids[first:])
        is_declared, is_possible = topic >= 0, log_ns >= 0  # of 63 bits
        self._impossible += int((~is_possible | (publish_ns < 0)).sum())
        self._undeclared.update(channel_ids[~is_declared].tolist())
        self._count_checked(block, starts, is_declared)
        self._see(block, starts, log_ns, is_possible if block.chunks else is_declared & is_possible)
        log_ns[~is_possible], publish_ns[publish_ns < 0] = LATEST_NS, NONE
        sequence = unaligned(block.data, "<u4")[at + MESSAGE_FIELDS["sequence"]].astype(np.int64)
        if count:
            columns = topic, log_ns, publish_ns, sequence
            batch = MessageBatch(self.topics, *columns, block.data, at + MESSAGE_HEADER.size, sizes)
            yield batch if is_declared.all() else batch.selected(is_declared)
        if is_beyond:
            self._budget.take()

    def _count_checked(self, block: Block, starts: Int64, is_declared: NDArray[np.bool_]) -> None:
        if block.is_doubtful:
            self.doubtful += int(is_declared.sum())
        elif not block.chunks:
            self.unchecked += int(is_declared.sum())
        else:
            for first, stop, chunk in _parts(block, starts):
                self.unchecked += 0 if chunk.crc else int(is_declared[first:stop].sum())

    def _see(self, block: Block, starts: Int64, log_ns: Int64, is_seen: NDArray[np.bool_]) -> None:
        for first, stop, _ in _parts(block, starts):
            possible_ns = log_ns[first:stop][is_seen[first:stop]]
            if len(possible_ns):
                self.chunks.append((int(possible_ns.min()), int(possible_ns.max()), stop - first))
                self.walk.saw(*self.chunks[-1][:2])
        if not block.chunks and is_seen.any():
            self.walk.saw_near(log_ns[is_seen])

    def _topics_of(self, channel_ids: NDArray[np.uint16]) -> Int64:
        """Return the indices of the topics of messages as the channels are declared now, -1 for an undeclared one."""
        if self._indices_are_of != self.channels.changes:
            self._indices_are_of = self.channels.changes
            self._indices.fill(-1)
        topic = self._indices[channel_ids]
        if len(topic) and topic.min() < 0:
            for channel_id in np.unique(channel_ids[topic < 0]).tolist():
                self._indices[channel_id] = self._topic_index(channel_id)
            topic = self._indices[channel_ids]
        return topic

    def _topic_index(self, channel_id: int) -> int:
        declared = self.channels.get(channel_id)
        if declared is None:
            self.walk.look_ahead()
            declared = self.channels.get(channel_id)
        if declared is None:
            return -1
        index = self._index_of.get(channel_id, -1)
        if index < 0 or self.records[index] is not declared.record:
            index = self._index_of[channel_id] = len(self.records)
            self.records.append(declared.record)
            self.topics.append(topic_of(declared.record, self.channels.schemas))
        return index

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
        except ValueError as err:
            self.walk.damages.append(f"the {record_name(opcode)} record at byte {offset} is damaged ({err})")


def _parts(block: Block, starts: Int64) -> Iterator[tuple[int, int, PackedChunk]]:
    edges = [*np.searchsorted(starts, [position for position, _ in block.chunks]).tolist(), len(starts)]
    yield from zip(edges, edges[1:], (chunk for _, chunk in block.chunks), strict=False)


def mcap_batches(path: Path, condition: Condition) -> Iterator[MessageBatch]:
    with closing(RecordFile(path)) as file:
        items = McapItems(file)
        try:
            for item in items:
                if isinstance(item, MessageBatch):
                    yield item
                elif isinstance(item, Metadata) and item.name == REMAINDER:
                    condition.is_remainder = True
                    condition.gone += gone_of(item.metadata.get(REMAINDER, ""))
        finally:
            condition.damages += items.walk.damages
            condition.notes += items.walk.notes
            condition.chunks += items.chunks
            names = {topic.name for topic in items.topics}
            silent = [declared.record for _, declared in items.channels.items() if declared.topic not in names]
            condition.topics |= {*items.topics} | {topic_of(channel, items.channels.schemas) for channel in silent}
            claims = [(items.channels.get(channel_id), count) for channel_id, count in items.claims.items()]
            for topic, count in [(declaration.topic, count) for declaration, count in claims if declaration]:
                condition.claimed[topic] = condition.claimed.get(topic, 0) + count
