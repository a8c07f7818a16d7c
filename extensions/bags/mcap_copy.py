"""A new MCAP file of messages that are copied as they are, chunk by chunk, with all its indexes."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from typing import IO

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from dds_trace.tracefile.format.encoding import MAGIC, MESSAGE_FIELDS, MESSAGE_HEADER, RECORD_HEADER
from dds_trace.tracefile.mcapfile.records import crc32
from dds_trace.tracefile.mcapfile.scan import unaligned
from dds_trace.tracefile.writing.event_chunks import encode_record

from .kinds import BLOCK_BYTES
from .recorded import Int64, MessageBatch

_INDEX_HEADER = struct.Struct("<BQHI")  # opcode, length, channel id, bytes of entries

_HEADER_BYTES = RECORD_HEADER.size + MESSAGE_HEADER.size
_LOG_TIME_AT = RECORD_HEADER.size + MESSAGE_FIELDS["log_time"]


def _unpacked(content: bytearray) -> bytearray:
    return content


class McapCopy:
    """Writes to `stream`; channels and schemas get ids from 1 on, and are repeated in the chunk of their first message."""

    def __init__(self, stream: IO[bytes], profile: str, library: str, *, is_packed: bool) -> None:
        self._stream = stream
        self._pack: Callable[[bytearray], bytes | bytearray] = _unpacked
        if is_packed:
            self._pack = zstandard.ZstdCompressor().compress
        self._compression = "zstd" if is_packed else ""
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self._declared, self._declared_schemas = 0, {0}
        self._content, self._rows = bytearray(), list[tuple[Int64, Int64, Int64]]()
        self._counts = Counter[int]()
        self._range_ns: tuple[int, int] | None = None
        self._indexes: dict[Opcode, list[McapRecord]] = {
            opcode: [] for opcode in (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)
        }
        stream.write(MAGIC)
        self._write(Header(profile=profile, library=library))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        self.schemas.append(Schema(id=len(self.schemas) + 1, name=name, encoding=encoding, data=data))
        return self.schemas[-1].id

    def add_channel(self, channel: Channel, schema_id: int) -> int:
        new_id = len(self.channels) + 1
        self.channels.append(
            Channel(
                id=new_id,
                topic=channel.topic,
                message_encoding=channel.message_encoding,
                metadata=channel.metadata,
                schema_id=schema_id,
            )
        )
        return new_id

    def add_messages(self, batch: MessageBatch, channel_ids: Int64) -> None:
        starts, ends = batch.starts - _HEADER_BYTES, batch.starts + batch.sizes
        parts = np.cumsum(ends - starts) // BLOCK_BYTES
        edges = [0, *(np.flatnonzero(np.diff(parts)) + 1).tolist(), len(batch)]
        for first, stop in pairwise(edges):
            self._add_records(batch, starts[first:stop], ends[first:stop], channel_ids[first:stop])
            if len(self._content) >= BLOCK_BYTES:
                self._finish_chunk()

    def _add_records(self, batch: MessageBatch, starts: Int64, ends: Int64, channel_ids: Int64) -> None:
        if not len(starts):
            return
        for channel in self.channels[self._declared :]:
            if channel.schema_id not in self._declared_schemas:
                self._declared_schemas.add(channel.schema_id)
                self._content += encode_record(self.schemas[channel.schema_id - 1])
            self._content += encode_record(channel)
        self._declared = len(self.channels)
        gaps = np.flatnonzero(starts[1:] != ends[:-1]) + 1
        offsets = len(self._content) + np.cumsum(ends - starts) - (ends - starts)
        for first, last in zip([0, *gaps.tolist()], [*gaps.tolist(), len(starts)], strict=True):
            self._content += batch.data[int(starts[first]) : int(ends[last - 1])]
        unaligned(self._content, "<u2")[offsets + RECORD_HEADER.size] = channel_ids
        self._rows.append((channel_ids, unaligned(self._content, "<u8")[offsets + _LOG_TIME_AT], offsets))

    def add_attachment(self, item: Attachment) -> None:
        at, length = self._write(item)
        about = {name: getattr(item, name) for name in ("log_time", "create_time", "name", "media_type")}
        index = AttachmentIndex(offset=at, length=length, data_size=len(item.data), **about)
        self._indexes[Opcode.ATTACHMENT_INDEX].append(index)

    def add_metadata(self, item: Metadata) -> None:
        at, length = self._write(item)
        self._indexes[Opcode.METADATA_INDEX].append(MetadataIndex(offset=at, length=length, name=item.name))

    def finish(self) -> None:
        if self._rows:
            self._finish_chunk()
        self._write(DataEnd(data_section_crc=0))
        first_ns, last_ns = self._range_ns or (0, 0)
        statistics = Statistics(
            attachment_count=len(self._indexes[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self.channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._indexes[Opcode.CHUNK_INDEX]),
            message_count=self._counts.total(),
            message_end_time=last_ns,
            message_start_time=first_ns,
            metadata_count=len(self._indexes[Opcode.METADATA_INDEX]),
            schema_count=len(self.schemas),
        )
        groups: dict[Opcode, list[McapRecord]] = {
            Opcode.SCHEMA: [*self.schemas],
            Opcode.CHANNEL: [*self.channels],
            Opcode.STATISTICS: [statistics],
            **self._indexes,
        }
        start, summary, offsets = self._stream.tell(), bytearray(), bytearray()
        for opcode, records in groups.items():
            group = b"".join(map(encode_record, records))
            if group:
                offsets += encode_record(
                    SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
                )
            summary += group
        footer = encode_record(Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0))[
            :-4
        ]  # its CRC covers all but itself
        summary += offsets + footer
        self._stream.write(summary + struct.pack("<I", crc32(summary)) + MAGIC)

    def _finish_chunk(self) -> None:
        channel_ids, log_ns, offsets = (np.concatenate(column) for column in zip(*self._rows, strict=True))
        content, first_ns, last_ns, compression = self._content, int(log_ns.min()), int(log_ns.max()), self._compression
        packed = self._pack(content)
        about = (first_ns, last_ns, len(content), crc32(content), len(compression), compression.encode(), len(packed))
        fields = struct.pack(f"<QQQII{len(compression)}sQ", *about)
        chunk_at, chunk_length = self._stream.tell(), RECORD_HEADER.size + len(fields) + len(packed)
        self._stream.write(RECORD_HEADER.pack(Opcode.CHUNK, chunk_length - RECORD_HEADER.size))
        self._stream.write(fields)
        self._stream.write(packed)
        index_at, index_offsets = self._stream.tell(), dict[int, int]()
        order = np.argsort(channel_ids, kind="stable")
        ids, firsts = np.unique(channel_ids[order], return_index=True)
        entries = np.array([log_ns[order], offsets[order].astype(np.uint64)]).T
        for channel_id, rows in zip(ids.tolist(), np.split(entries, firsts[1:]), strict=True):
            index_offsets[channel_id] = self._stream.tell()
            head = _INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + rows.nbytes, channel_id, rows.nbytes)
            self._stream.write(head + rows.tobytes())
            self._counts[channel_id] += len(rows)
        self._indexes[Opcode.CHUNK_INDEX].append(
            ChunkIndex(
                chunk_length=chunk_length,
                chunk_start_offset=chunk_at,
                compression=compression,
                compressed_size=len(packed),
                message_end_time=last_ns,
                message_index_length=self._stream.tell() - index_at,
                message_index_offsets=index_offsets,
                message_start_time=first_ns,
                uncompressed_size=len(content),
            )
        )
        first, last = self._range_ns or (first_ns, last_ns)
        self._range_ns = min(first, first_ns), max(last, last_ns)
        self._content.clear()
        self._rows.clear()

    def _write(self, record: McapRecord) -> tuple[int, int]:
        at = self._stream.tell()
        return at, self._stream.write(encode_record(record))
