"""The MCAP file of a trace, readable after each of its chunks, and its ring."""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Footer, Header, Message, Schema, Statistics, SummaryOffset

from dds_trace.base.errors import OutputError
from dds_trace.base.files import OWNER_AND_GROUP, flush_to_disk, output_error
from dds_trace.base.version import __version__

from ..format.bag_metadata import METADATA_NAME, BagFile, RecordedTopic, write_bag_metadata
from ..format.descriptions import Session
from ..format.encoding import MAGIC, encode_string
from ..format.events import SESSION_TOPIC, Stage
from ..format.ring import Ring, Slots, ring_path
from ..mcapfile.records import crc32, topic_of
from .destination import TraceDestination, make_room
from .event_chunks import (
    EVENT_SCHEMA,
    EVENT_TOPICS,
    LIBRARY,
    SCHEMAS,
    STRING_SCHEMA,
    TAP_SCHEMA,
    TEXT_TOPICS,
    TYPE_HASHES,
    Chunk,
    EventChunkBuilder,
    Payload,
    declarations_of,
    encode_record,
    payload_chunk,
    positions_by_channel,
)

MAX_CHUNK_EVENTS = 1 << 14
"""Most events of a chunk: 1.5 MB before compression."""

ZSTD_LEVEL = -1  # level 1 saves a tenth of the size in twice the time, level 3 no more

_CHUNK_HEADER = struct.Struct("<BQQQQI")  # opcode, length, start, end, uncompressed size, CRC of that
_INDEX_HEADER = struct.Struct("<BQHI")  # opcode, length, channel id, bytes of entries
_COMPRESSION = b"\x04\x00\x00\x00zstd"


class TraceWriter(AbstractContextManager["TraceWriter"]):
    """Writer of one trace at a new path; every method leaves a readable file, even if it fails, as does the end of its context.

    The session's clock anchor turns monotonic times into log times. With `fsync` each chunk is on the disk on return.
    """

    def __init__(self, path: Path, session: Session, *, fsync: bool = False, mode: int = OWNER_AND_GROUP) -> None:
        self.path = path
        self._fsync = fsync
        self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
        self._builder = EventChunkBuilder(session.wall_ns(0), MAX_CHUNK_EVENTS)
        self._schemas = dict(SCHEMAS)
        self._channels: dict[str | RecordedTopic, Channel] = {}
        self._counts: dict[int, int] = {}  # channel id -> number of messages in the file
        self._indexes = bytearray()  # of the chunks so far, as in the summary: a week of seconds has 600,000
        self._chunk_count = 0
        self._first_ns = 0
        self._last_ns = 0
        self._end = 0
        self._length = 0  # more than `_end` where an incomplete write could not be cut off
        for topic in EVENT_TOPICS:
            self._own_channel(topic, TAP_SCHEMA if topic == Stage.TAP.topic else EVENT_SCHEMA)
        for topic in TEXT_TOPICS:
            self._own_channel(topic, STRING_SCHEMA)
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        except OSError as err:
            raise output_error(path, err) from err
        self._is_open = True
        try:
            self._append([MAGIC, encode_record(Header(profile="ros2", library=f"{LIBRARY} {__version__}"))])
        except OutputError:
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    @property
    def bytes_written(self) -> int:
        return self._end

    @property
    def events(self) -> int:
        return sum(self._counts.get(self._channels[topic].id, 0) for topic in EVENT_TOPICS)

    @property
    def topics(self) -> list[tuple[RecordedTopic, int]]:
        return [(topic_of(channel, self._schemas), self._counts[channel.id]) for channel in self._used_channels()]

    @property
    def time_range_ns(self) -> tuple[int, int]:
        return self._first_ns, self._last_ns

    def write_metadata(self, trace: Path, mode: int, *, fsync: bool) -> None:
        """Write `metadata.yaml` next to the one file of a bag, without QoS: a player uses its default."""
        file = BagFile(trace.name, self._first_ns, self._last_ns - self._first_ns, sum(self._counts.values()))
        write_bag_metadata(trace.parent, "mcap", [file], self.topics, mode=mode, fsync=fsync)

    def write_events(self, slots: Slots) -> None:
        """Append events in the order of `slots`, in chunks; after an error the chunks before it are in the file."""
        for first in range(0, len(slots), MAX_CHUNK_EVENTS):
            chunk = slots[first : first + MAX_CHUNK_EVENTS]
            by_channel = positions_by_channel(chunk)
            channels = [self._channels[EVENT_TOPICS[number - 1]] for number in by_channel]
            declarations = declarations_of(channels, self._schemas)
            built = self._builder.build(chunk, by_channel, declarations, self._counts, self._last_ns)
            self._write_chunk(built)

    def write_text(self, topic: str, text: str, time_ns: int) -> None:
        """Append a String in its own chunk, so that no later damage loses it; log times never decrease."""
        channel = self._own_channel(topic, STRING_SCHEMA)
        log_time = max(time_ns, self._last_ns)
        message = Message(
            channel_id=channel.id,
            log_time=log_time,
            publish_time=log_time,
            sequence=self._counts.get(channel.id, 0),
            data=encode_string(text),
        )
        declarations = declarations_of([channel], self._schemas)
        content = memoryview(declarations + encode_record(message))
        index = np.array([[log_time, len(declarations)]], np.uint64)
        self._write_chunk(Chunk(content, log_time, log_time, {channel.id: index}))

    def write_payloads(self, batch: Sequence[Payload]) -> None:
        """Append messages of others in one uncompressed chunk: images hardly shrink, and a blank one too much to be believed."""
        channels = {payload.topic: self._payload_channel(payload.topic) for payload in batch}
        declarations = declarations_of(list(channels.values()), self._schemas)
        by_channel = [(channels[payload.topic].id, payload) for payload in batch]
        self._write_chunk(payload_chunk(declarations, by_channel, self._counts), is_packed=False)

    def finish(self) -> None:
        summary_start = self._end + len(encode_record(DataEnd(0)))
        channels = self._used_channels()
        schemas = {channel.schema_id: self._schemas[channel.schema_id] for channel in channels}
        start_ns, end_ns = self.time_range_ns
        statistics = Statistics(
            message_count=sum(self._counts.values()),
            schema_count=len(schemas),
            channel_count=len(channels),
            attachment_count=0,
            metadata_count=0,
            chunk_count=self._chunk_count,
            message_start_time=start_ns,
            message_end_time=end_ns,
            channel_message_counts=self._counts,
        )
        groups: list[tuple[Opcode, bytes | bytearray]] = [
            (Opcode.SCHEMA, b"".join(map(encode_record, schemas.values()))),
            (Opcode.CHANNEL, b"".join(map(encode_record, channels))),
            (Opcode.STATISTICS, encode_record(statistics)),
            (Opcode.CHUNK_INDEX, self._indexes),
        ]
        summary = offsets = b""
        for opcode, group in groups:
            if group:
                offsets += encode_record(SummaryOffset(opcode, summary_start + len(summary), len(group)))
            summary += group
        offsets_start = summary_start + len(summary)
        footer = encode_record(Footer(summary_start, offsets_start, 0))[:-4]  # its CRC covers all but itself
        summary += offsets + footer
        self._append([encode_record(DataEnd(0)), summary, struct.pack("<I", crc32(summary)), MAGIC])
        self._check_unchanged()
        self.abandon()

    def abandon(self) -> None:
        if self._is_open:
            os.close(self._descriptor)
        self._is_open = False

    def __exit__(self, *_exception: object) -> None:
        self.abandon()

    def _own_channel(self, topic: str, schema: Schema) -> Channel:
        if topic not in self._channels:
            self._declare(topic, topic, schema, "cdr", {"topic_type_hash": TYPE_HASHES[schema.name]})
        return self._channels[topic]

    def _payload_channel(self, topic: RecordedTopic) -> Channel:
        if topic not in self._channels:
            encoding, text = "ros2msg" if topic.definition else "", topic.definition.encode()
            schema = Schema(data=text, encoding=encoding, id=len(self._schemas) + 1, name=topic.message_type)
            self._schemas[schema.id] = schema
            self._declare(topic, topic.name, schema, topic.encoding, {})
        return self._channels[topic]

    def _declare(
        self, key: str | RecordedTopic, topic: str, schema: Schema, encoding: str, metadata: dict[str, str]
    ) -> None:
        self._channels[key] = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, metadata=metadata, schema_id=schema.id
        )

    def _used_channels(self) -> list[Channel]:
        return [channel for channel in self._channels.values() if channel.id in self._counts]

    def _write_chunk(self, chunk: Chunk, *, is_packed: bool = True) -> None:
        compressed = self._compressor.compress(chunk.content) if is_packed else chunk.content
        compression = _COMPRESSION if is_packed else bytes(4)
        size = len(chunk.content)
        body = _CHUNK_HEADER.size - 9 + len(compression) + 8 + len(compressed)
        header = _CHUNK_HEADER.pack(Opcode.CHUNK, body, chunk.start_ns, chunk.end_ns, size, crc32(chunk.content))
        parts: list[bytes | memoryview] = [header + compression + struct.pack("<Q", len(compressed)), compressed]
        chunk_length = 9 + body
        index_at = self._end + chunk_length
        offsets = {}
        for channel_id, entries in chunk.index.items():
            offsets[channel_id] = index_at
            parts += [
                _INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel_id, entries.nbytes),
                entries.data.cast("B"),
            ]
            index_at += _INDEX_HEADER.size + entries.nbytes
        description = ChunkIndex(
            message_start_time=chunk.start_ns,
            message_end_time=chunk.end_ns,
            chunk_start_offset=self._end,
            chunk_length=chunk_length,
            message_index_offsets=offsets,
            message_index_length=index_at - self._end - chunk_length,
            compression="zstd" if is_packed else "",
            compressed_size=len(compressed),
            uncompressed_size=size,
        )
        self._append(parts)
        self._indexes += encode_record(description)
        self._first_ns = min(self._first_ns, chunk.start_ns) if self._chunk_count else chunk.start_ns
        self._chunk_count += 1
        for channel_id, entries in chunk.index.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + len(entries)
        self._last_ns = max(self._last_ns, chunk.end_ns)

    def _append(self, parts: Sequence[bytes | memoryview]) -> None:
        """Write all or nothing: bytes of an incomplete write are cut off again."""
        self._check_unchanged()
        end = self._end
        try:
            end += os.pwritev(self._descriptor, parts, end)
            remainder = memoryview(b"")
            if end - self._end < sum(map(len, parts)):  # a disk fills up during a write
                remainder = memoryview(b"".join(parts))[end - self._end :]
            while remainder:
                written = os.pwrite(self._descriptor, remainder, end)
                end, remainder = end + written, remainder[written:]
            if self._fsync:
                os.fsync(self._descriptor)
        except OSError as err:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._end)
            with suppress(OSError):
                self._length = os.fstat(self._descriptor).st_size
            raise output_error(self.path, err) from err
        self._length = max(self._length, end)
        self._end = end

    def _check_unchanged(self) -> None:
        try:
            number = self._change()
        except OSError as err:
            raise output_error(self.path, err) from err
        if number:
            cause = OSError(number, "changed")
            raise output_error(self.path, cause) from cause

    def _change(self) -> int:
        status = os.fstat(self._descriptor)
        if status.st_nlink == 0:
            return errno.ENOENT
        with suppress(FileNotFoundError, NotADirectoryError):  # its folder was moved: it is still written
            if not os.path.samestat(status, self.path.lstat()):
                return errno.ESTALE
        # A file truncated during a write has its length again, and a hole at its start.
        is_whole = not self._end or os.pread(self._descriptor, len(MAGIC), 0) == MAGIC
        return 0 if is_whole and status.st_size == self._length else errno.ESTALE


class TraceFiles:
    """A new trace file with its session's description, and its empty ring; `drained` events are in the file."""

    def __init__(self, destination: TraceDestination, session: Session, time_ns: int) -> None:
        self.destination = destination
        self.drained = 0
        trace = destination.trace_path
        make_room(destination)
        self.writer = TraceWriter(trace, session, fsync=destination.fsync, mode=destination.mode)
        try:
            self.writer.write_text(SESSION_TOPIC, session.to_json(), time_ns)
            self.ring = Ring(ring_path(trace), destination.ring_slots, session, mode=destination.mode)
            if destination.fsync:  # content of a file without a name on the disk is lost
                flush_to_disk(trace.parent)
        except (OutputError, OSError) as err:
            self.writer.abandon()
            trace.unlink(missing_ok=True)
            raise (err if isinstance(err, OutputError) else output_error(ring_path(trace), err)) from err

    def move_chunk(self, head: int) -> None:
        """Move the ring's next chunk below ticket `head` to the file."""
        slots = self.ring.pending(self.drained, min(head, self.drained + MAX_CHUNK_EVENTS))
        self.writer.write_events(slots)
        self.drained += len(slots)

    def finish(self) -> OutputError | None:
        try:
            self.writer.finish()
            if self.destination.is_bag:
                self.writer.write_metadata(self.writer.path, self.destination.mode, fsync=self.destination.fsync)
        except OutputError as err:
            self.writer.abandon()
            return err
        except OSError as err:
            return output_error(self.writer.path.with_name(METADATA_NAME), err)
        return None
