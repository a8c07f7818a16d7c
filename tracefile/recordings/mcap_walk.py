"""Every whole message of any MCAP file: damage is stepped over up to the next bytes that are a record again.

A chunk with a CRC that matches is believed. In any other each record must fit what follows it, and its messages are `doubtful`.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import suppress
from typing import NamedTuple, TypeAlias

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics

from dds_trace.base.units import counted

from ..format.encoding import MAGIC, MESSAGE_HEADER, RECORD_HEADER
from ..mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from ..mcapfile.chunks import DamagedChunkError, PackedChunk
from ..mcapfile.file import MAX_RECORD_BYTES, RecordFile, RecordHeader, TornRecordError, read_summary
from ..mcapfile.records import parse_record, record_name
from ..reading.recorded import LATEST_NS, Budget, UnreadableError

_LEAST_BYTES = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: MESSAGE_HEADER.size,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 60,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 40,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}
_EXACT = frozenset({Opcode.FOOTER, Opcode.SUMMARY_OFFSET, Opcode.DATA_END})
_PRIVATE = 0x80
_START = re.compile(rb"[\x01-\x0f].{3}[\x00-\x04]\x00{4}", re.DOTALL)  # an opcode, a length of about 64 MiB at most
_SEARCHED_BYTES = 1 << 20
_UNSUSPECTED_LOOKS = 1_000_000
_DAY_NS = 86_400 * 10**9


class WalkedMessage(NamedTuple):
    channel: Channel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


Item: TypeAlias = "WalkedMessage | Attachment | Metadata"


class UnpackedRecords:
    def __init__(self, data: bytes | bytearray | memoryview) -> None:
        self._data = bytes(data)
        self.size = len(data)

    def read(self, offset: int, size: int) -> bytes:
        return self._data[offset : offset + size]

    peek = read

    def header_at(self, offset: int) -> RecordHeader:
        if offset + RECORD_HEADER.size > self.size:
            raise TornRecordError(offset, "a record's header is cut off")
        opcode, length = RECORD_HEADER.unpack_from(self._data, offset)
        if length > self.size - offset - RECORD_HEADER.size:
            raise TornRecordError(offset, f"a {record_name(opcode)} record is cut off")
        return RecordHeader(opcode, offset, length)


class McapWalk:
    """One-time iterable of the messages, attachments and metadata of a file, in file order."""

    def __init__(self, file: RecordFile, *, looks_ahead: bool = True) -> None:
        self._file = file
        self._looks_ahead = looks_ahead
        self._budget = Budget(file.size)
        self._looks_left = _UNSUSPECTED_LOOKS + file.size
        self._unpacked_bytes = 0
        self._is_in_damage = False
        self._range_ns: tuple[int, int] | None = None
        self._undeclared: dict[int, int] = {}
        self._impossible = 0
        self.header: Header | None = None
        self.closed = False
        self.is_unpacked = True
        self.damages: list[str] = []
        self.notes: list[str] = []
        self.doubtful = 0
        self.unchecked = 0
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.claims: dict[int, int] = {}
        self.chunks: list[tuple[int, int, int]] = []
        self._in_summary = frozenset[int](), frozenset[int]()
        summary = read_summary(file)
        for opcode, content, _ in summary.declarations() if summary else ():
            self._declare(opcode, bytes(content))
        self._in_summary = frozenset(self.schemas), frozenset(self.channels)

    def __iter__(self) -> Iterator[Item]:
        at = self._first_record()
        while at is not None:
            header = self._record_at(self._file, at)
            if header is None:
                yield from self._cut_chunk(at)
                at = self._next_record(at)
            elif header.opcode == Opcode.CHUNK:
                chunk = PackedChunk.at(self._file, header, is_cut=True)
                fits = self._fits_next(self._file, header.end)
                is_sound = yield from self._chunk(chunk, uses_damaged=fits or bool(chunk.compression))
                self._is_in_damage = not is_sound
                next_chunk = None if is_sound else self._chunk_within(chunk)
                at = next_chunk or (header.end if fits or is_sound else self._next_record(at))
            else:
                yield from self._single(self._file, header)
                at = self._after_footer(header.end) if header.opcode == Opcode.FOOTER else header.end
        for channel_id, count in self._undeclared.items():
            self.damages.append(f"{counted(count, 'message')} of channel {channel_id}: its declaration is lost")
        if self._impossible:
            impossible = counted(self._impossible, "message has a time", "messages have times")
            self.damages.append(f"{impossible} that no clock shows (after the year 2262)")

    def _chunk_within(self, chunk: PackedChunk) -> int | None:
        at = self._resume(self._file, chunk.offset, chunk.end) if chunk.compression else None
        while at is not None and self._file.peek(at, 1)[0] != Opcode.CHUNK:
            at = self._resume(self._file, at, chunk.end)
        return at

    def _next_record(self, at: int) -> int | None:
        resumed_at = self._resume(self._file, at)
        self._is_in_damage = True
        if resumed_at is not None:
            self.damages.append(f"at byte {at} {counted(resumed_at - at, 'byte is', 'bytes are')} no record")
        elif self._file.size > at:
            unread = counted(self._file.size - at, "byte")
            self.damages.append(f"it was not closed: {unread} of an unfinished record and no index at its end")
        else:
            self.damages.append("it was not closed: it has no index")
        return resumed_at

    def _first_record(self) -> int | None:
        if self._file.read(0, min(len(MAGIC), self._file.size)) == MAGIC:
            return len(MAGIC)
        self._is_in_damage = True
        at = self._resume(self._file, -1)
        if at is None:
            raise UnreadableError("not a MCAP file: it does not begin with MCAP's magic bytes, and no record was found")
        self.damages.append(f"it does not begin with MCAP's magic bytes; its first record is at byte {at}")
        return at

    def _after_footer(self, at: int) -> int | None:
        self.closed = True
        end = at + len(MAGIC)
        if self._file.read(at, min(len(MAGIC), self._file.size - at)) != MAGIC:
            self.damages.append(f"at byte {at} the closing magic bytes are not there")
        elif end == self._file.size:
            return None
        self._is_in_damage = True
        resumed_at = self._resume(self._file, end - 1)
        if resumed_at is not None:
            self.damages.append(f"at byte {resumed_at} records follow the end of the MCAP file")
        elif end < self._file.size:
            self.notes.append(f"the bytes from {end} on follow the end of the MCAP file and were ignored")
        return resumed_at

    def _look_ahead(self) -> None:
        """Declare what is declared after its first message, as in a file with its parts in disorder."""
        if self._looks_ahead:
            self._looks_ahead = False
            ahead = McapWalk(self._file, looks_ahead=False)
            ahead.schemas, ahead.channels = dict(self.schemas), dict(self.channels)
            with suppress(UnreadableError):
                deque(ahead, 0)
            self.schemas, self.channels = {**ahead.schemas, **self.schemas}, {**ahead.channels, **self.channels}

    def _record_at(self, source: RecordFile | UnpackedRecords, at: int) -> RecordHeader | None:
        try:
            header = source.header_at(at)
        except TornRecordError:
            header = None
        if source is self._file and (header is None or header.opcode == Opcode.CHUNK):
            return self._chunk_at(at)
        if header is None or not _has_shape(header):
            return None
        closing = MAGIC[: max(source.size - header.end, 0)]
        if header.opcode == Opcode.FOOTER and source.read(header.end, len(closing)) != closing:
            return None
        if self._is_in_damage or source is not self._file or not self._fits_next(source, header.end):
            inside = self._resume(source, header.offset, header.end)
            return header if inside is None else None
        return header

    def _chunk_at(self, at: int) -> RecordHeader | None:
        """Return a chunk, its length from its fields, or from its record where they cannot be right."""
        if self._file.size - at < RECORD_HEADER.size or self._file.peek(at, 1)[0] != Opcode.CHUNK:
            return None
        remainder = RecordHeader(Opcode.CHUNK, at, self._file.size - at - RECORD_HEADER.size)
        ends = []
        with suppress(DamagedChunkError):
            ends.append(PackedChunk.at(self._file, remainder).end)
        with suppress(TornRecordError):
            ends.append(self._file.header_at(at).end)
        for end in ends:
            if self._fits_next(self._file, end) or len(ends) - len(set(ends)):
                header = RecordHeader(Opcode.CHUNK, at, end - remainder.content)
                with suppress(DamagedChunkError):
                    PackedChunk.at(self._file, header, is_cut=True)
                    return header
        return None

    def _fits_next(self, source: RecordFile | UnpackedRecords, at: int) -> bool:
        try:
            return _has_shape(source.header_at(at))
        except TornRecordError:
            remaining = source.read(at, min(max(source.size - at, 0), RECORD_HEADER.size))
            if not remaining or (remaining == MAGIC and source is self._file):
                return True
            # A record that the end of the file cuts off.
            return remaining[0] in _OPCODES and int.from_bytes(remaining[1:], "little") <= MAX_RECORD_BYTES

    def _resume(self, source: RecordFile | UnpackedRecords, damaged_at: int, stop: int | None = None) -> int | None:
        at, stop = damaged_at + 1, source.size if stop is None else stop
        while at < stop and source.size - at >= RECORD_HEADER.size:
            data = source.read(at, min(_SEARCHED_BYTES, source.size - at, stop - at + RECORD_HEADER.size - 1))
            searched = 0
            while match := _START.search(data, searched):
                self._looks_left -= 1
                if self._looks_left < 0:
                    raise UnreadableError("too little of it is records")
                if self._is_record(source, at + match.start()):
                    return at + match.start()
                searched = match.start() + 1
            at += len(data) - RECORD_HEADER.size + 1
        return None

    def _is_record(self, source: RecordFile | UnpackedRecords, at: int) -> bool:
        try:
            header = source.header_at(at)
        except TornRecordError:
            return False
        if not _has_shape(header):
            return False
        if header.opcode == Opcode.CHUNK:
            by_its_fields = self._chunk_at(at) if source is self._file else None
            return by_its_fields is not None and by_its_fields.end == header.end
        if header.opcode == Opcode.MESSAGE:
            channel_id, _, log_ns, _ = MESSAGE_HEADER.unpack(source.peek(header.content, MESSAGE_HEADER.size))
            if channel_id not in self.channels:
                self._look_ahead()
            if channel_id not in self.channels or not self._is_near(log_ns):
                return False
        return self._fits_next(source, header.end)

    def _is_near(self, log_ns: int) -> bool:
        first_ns, last_ns = self._range_ns or (log_ns, log_ns)
        return first_ns - _DAY_NS <= log_ns <= last_ns + _DAY_NS

    def _cut_chunk(self, at: int) -> Iterator[Item]:
        if self._file.size - at < RECORD_HEADER.size or self._file.peek(at, 1)[0] != Opcode.CHUNK:
            return
        try:
            header = RecordHeader(Opcode.CHUNK, at, self._file.size - at - RECORD_HEADER.size)
            chunk = PackedChunk.at(self._file, header, is_cut=True)
        except DamagedChunkError as err:
            self.damages.append(f"the chunk at byte {at} is damaged ({err}) and left out")
            return
        if chunk.compression:
            yield from self._doubtful_chunk(chunk, "it is cut off")

    def _chunk(self, chunk: PackedChunk, *, uses_damaged: bool) -> Generator[Item, None, bool]:
        self._unpacked_bytes += chunk.unpacked_bytes
        self.is_unpacked &= not chunk.compression
        if self._unpacked_bytes > most_unpacked_bytes(chunk.data_offset + chunk.packed_bytes):
            raise UnreadableError(f"it unpacks to more than {LARGEST_FILE_RATIO} times its size")
        try:
            data = chunk.unpack(self._file)
        except DamagedChunkError as err:
            if uses_damaged:
                yield from self._doubtful_chunk(chunk, str(err))
            return False
        if not chunk.crc and not _is_whole(data):
            if uses_damaged:
                yield from self._doubtful_chunk(chunk, "a record in it is damaged")
            return False
        first_ns, last_ns, count = 2**64, 0, 0
        at = 0
        while len(data) - at >= RECORD_HEADER.size:
            opcode, length = RECORD_HEADER.unpack_from(data, at)
            start = at + RECORD_HEADER.size
            at = start + length
            if opcode == Opcode.MESSAGE:
                channel_id, sequence, log_ns, publish_ns = MESSAGE_HEADER.unpack_from(data, start)
                first_ns, count = min(first_ns, log_ns), count + 1
                last_ns = max(last_ns, log_ns if log_ns <= LATEST_NS else 0)
                content = bytes(data[start + MESSAGE_HEADER.size : at])
                yield from self._message(channel_id, sequence, log_ns, publish_ns, content)
            else:
                self._declare(opcode, bytes(data[start:at]))
        if count:
            if first_ns <= last_ns:
                self.chunks.append((first_ns, last_ns, count))
                self._saw(first_ns, last_ns)
            self.unchecked += 0 if chunk.crc else count
        return True

    def _doubtful_chunk(self, chunk: PackedChunk, why: str) -> Iterator[Item]:
        source, count, at = UnpackedRecords(chunk.unpack_prefix(self._file)), 0, 0
        while True:
            header = self._record_at(source, at)
            if header is None:
                resumed_at = self._resume(source, at)
                if resumed_at is None:
                    break
                at = resumed_at
                continue
            for item in self._single(source, header):
                count += 1
                yield item
            at = header.end
        self.doubtful += count
        used = f"{counted(count, 'message')} of it {'is' if count == 1 else 'are'} used"
        self.damages.append(f"the chunk at byte {chunk.offset} is damaged ({why}); {used}")

    def _single(self, source: RecordFile | UnpackedRecords, header: RecordHeader) -> Iterator[Item]:
        if header.length > MAX_RECORD_BYTES:
            name = record_name(header.opcode)
            self.damages.append(
                f"the {name} record of {counted(header.length, 'byte')} at byte {header.offset} is left out"
            )
            return
        content = source.read(header.content, header.length)
        if header.opcode == Opcode.MESSAGE:
            channel_id, sequence, log_ns, publish_ns = MESSAGE_HEADER.unpack_from(content)
            if channel_id in self.channels and self._is_near(log_ns):
                self._saw(log_ns, log_ns)
            self.unchecked += source is self._file
            yield from self._message(channel_id, sequence, log_ns, publish_ns, content[MESSAGE_HEADER.size :])
            return
        try:
            if header.opcode == Opcode.HEADER and self.header is None:
                self.header = parse_record(Header, content)
            elif header.opcode == Opcode.STATISTICS:
                self.claims = parse_record(Statistics, content).channel_message_counts
            elif header.opcode == Opcode.ATTACHMENT:
                yield parse_record(Attachment, content)
            elif header.opcode == Opcode.METADATA:
                yield parse_record(Metadata, content)
        except ValueError as err:
            self.damages.append(f"the {record_name(header.opcode)} record at byte {header.offset} is damaged ({err})")
        self._declare(header.opcode, content)

    def _message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> Iterator[Item]:
        self._budget.take()
        self._impossible += max(log_ns, publish_ns) > LATEST_NS
        if channel_id not in self.channels:
            self._look_ahead()
        channel = self.channels.get(channel_id)
        if channel is None:
            self._undeclared[channel_id] = self._undeclared.get(channel_id, 0) + 1
        else:
            yield WalkedMessage(channel, sequence, log_ns, publish_ns, data)

    def _saw(self, first_ns: int, last_ns: int) -> None:
        first, last = self._range_ns or (first_ns, last_ns)
        self._range_ns = min(first, first_ns), max(last, last_ns)

    def _declare(self, opcode: int, content: bytes) -> None:
        is_schema = opcode == Opcode.SCHEMA
        if not is_schema and opcode != Opcode.CHANNEL:
            return
        try:
            record = parse_record(Schema, content) if is_schema else parse_record(Channel, content)
        except ValueError as err:
            self.damages.append(f"a {record_name(opcode)} record is damaged ({err})")
            return
        if isinstance(record, Schema):
            if record.id not in self._in_summary[0]:
                self.schemas[record.id] = record
        elif record.id not in self._in_summary[1]:
            self.channels[record.id] = record


def _has_shape(header: RecordHeader) -> bool:
    least_bytes = _LEAST_BYTES.get(Opcode(header.opcode)) if header.opcode in _OPCODES else None
    if least_bytes is None:
        return header.opcode >= _PRIVATE
    return header.length == least_bytes if header.opcode in _EXACT else header.length >= least_bytes


_OPCODES = frozenset(map(int, _LEAST_BYTES))


def _is_whole(data: memoryview) -> bool:
    at = 0
    while len(data) - at >= RECORD_HEADER.size:
        opcode, length = RECORD_HEADER.unpack_from(data, at)
        if opcode not in {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE} or length < _LEAST_BYTES[opcode]:
            return False
        at += RECORD_HEADER.size + length
    return at == len(data)
