"""A walk over any MCAP file, block by block: damage is stepped over up to the next bytes that are a record again.

As long as every record is followed by another, jobs in other threads unpack chunks ahead. A chunk with a CRC that matches is
believed. In any other, and from a damage on until such a chunk, each record must fit what follows it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import closing, suppress
from functools import partial

from mcap.opcode import Opcode
from mcap.records import Header

from dds_trace.base.threads import InlineExecutor, in_order
from dds_trace.base.units import counted

from ..format.encoding import MAGIC, MESSAGE_HEADER, RECORD_HEADER
from ..mcapfile.blocks import (
    BLOCK_BYTES,
    LARGEST_FILE_RATIO,
    LEAST_BYTES,
    Block,
    most_unpacked_bytes,
    outside_block,
    unpack_chunks,
)
from ..mcapfile.chunks import DamagedChunkError, PackedChunk
from ..mcapfile.file import MAX_RECORD_BYTES, RecordFile, RecordHeader, Records, TornRecordError, read_summary
from ..mcapfile.records import ChannelTable, record_name
from ..mcapfile.scan import MESSAGES_AND_CHANNELS, Int64, Scan, scan_records, single_record
from .source import UnreadableError

_EXACT = frozenset({Opcode.FOOTER, Opcode.DATA_END})
_OUTSIDE = MESSAGES_AND_CHANNELS | {Opcode.HEADER, Opcode.STATISTICS, Opcode.ATTACHMENT, Opcode.METADATA}
_PRIVATE = 0x80
_OPCODES = frozenset(map(int, LEAST_BYTES))
_START = re.compile(rb"[\x01-\x0f].{3}[\x00-\x04]\x00{4}", re.DOTALL)  # an opcode, a length of about 64 MiB at most
_SEARCHED_BYTES = 1 << 20
_UNSUSPECTED_LOOKS = 1_000_000
_DAY_NS = 86_400 * 10**9
_FIRST_STRETCH_BYTES = 4096
_BLOCK_CHUNKS = 1000
_BLOCK_BYTES_OF_OTHERS = 3 * BLOCK_BYTES  # read by one thread: less often, and images are long
_MOST_BLOCKS_AHEAD = 8
_BYTES_AHEAD = 32 << 20  # of all these blocks
_TOO_MUCH = f"it unpacks to more than {LARGEST_FILE_RATIO} times its size"


class McapWalk:
    """One-time iterable of the blocks of a file; who reads a block adds its declarations to `channels` in their order.

    Of a trace of ours a damaged chunk is left out whole, and nothing after the footer is read. `torn` is the end of a file
    that was not closed.
    """

    def __init__(self, file: RecordFile, *, is_trace: bool = False, looks_ahead: bool = True) -> None:
        self._file, self._is_trace, self._looks_ahead = file, is_trace, looks_ahead
        self.pool: Executor = InlineExecutor()
        self.channels = ChannelTable(file.path, is_trace=is_trace)
        self.damages: list[str] = []
        self.notes: list[str] = []
        self.torn: TornRecordError | None = None
        self.closed = False
        self.headers = 0
        self.damaged_chunks = 0
        self.is_unpacked = True
        self.header: Header | None = None
        with suppress(TornRecordError):
            header = file.header_at(len(MAGIC))
            self.header = file.parse(Header, header) if header.opcode == Opcode.HEADER else None
        summary = read_summary(file)
        for declaration in summary.declarations() if summary else ():
            self.declare(*declaration)
        self.claimed = summary.message_counts() if summary else None
        self.is_checked = summary is not None and summary.is_checked
        if self.is_checked:
            self.channels.settle()
        self._at: int | None = 0
        self._is_in_damage = False
        self._stretch_bytes = _FIRST_STRETCH_BYTES
        self._looks_left = _UNSUSPECTED_LOOKS + file.size
        self._unpacked_bytes = 0
        self._block_bytes = BLOCK_BYTES if is_trace else _BLOCK_BYTES_OF_OTHERS
        self._range_ns: tuple[int, int] | None = None

    @property
    def torn_bytes(self) -> int:
        return max(self._file.size - self.torn.offset, 0) if self.torn and not self.closed else 0

    def __iter__(self) -> Iterator[Block]:
        self._at = self._first_record()
        while self._at is not None:
            if not self._is_in_damage:
                yield from self._ahead()
            yield from self._step(self._at)

    def declare(self, opcode: int, content: bytes | memoryview, offset: int) -> None:
        fault = self.channels.declare(opcode, content, offset)
        if fault:
            self.damages.append(fault)

    def look_ahead(self) -> None:
        """Declare what is declared after its first message, as in a file with its parts in disorder."""
        if self._looks_ahead:
            self._looks_ahead = False
            ahead = McapWalk(self._file, is_trace=self._is_trace, looks_ahead=False)
            ahead.channels.add_missing(self.channels)
            with suppress(UnreadableError):
                for block in ahead:
                    for opcode, start, length in block.scan.others:
                        if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                            ahead.declare(opcode, bytes(block.data[start : start + length]), block.offset(start))
            self.channels.add_missing(ahead.channels)

    def saw(self, first_ns: int, last_ns: int) -> None:
        """Take the times of messages that are believed; others are compared with them."""
        first, last = self._range_ns or (first_ns, last_ns)
        self._range_ns = min(first, first_ns), max(last, last_ns)

    def saw_near(self, log_ns: Int64) -> None:
        """Take the times of messages outside of chunks, one after the other as far as each is near."""
        ends_ns = [int(log_ns.min()), int(log_ns.max())]
        are_near = self._range_ns is not None and all(map(self.is_near, ends_ns))
        for time_ns in filter(self.is_near, ends_ns if are_near else log_ns.tolist()):
            self.saw(time_ns, time_ns)

    def is_near(self, log_ns: int) -> bool:
        first_ns, last_ns = self._range_ns or (log_ns, log_ns)
        return first_ns - _DAY_NS <= log_ns <= last_ns + _DAY_NS

    def _first_record(self) -> int | None:
        begin = self._file.read(0, min(len(MAGIC), self._file.size))
        if begin == MAGIC or (self._is_trace and MAGIC.startswith(begin)):
            return len(begin)
        self._is_in_damage = True
        at = self._resume(self._file, -1)
        if at is None or (self._is_trace and self._file.peek(at, 1)[0] not in {Opcode.HEADER, Opcode.CHUNK}):
            raise UnreadableError("not a MCAP file: it does not begin with MCAP's magic bytes, and no record was found")
        self.damages.append(f"it does not begin with MCAP's magic bytes; its first record is at byte {at}")
        return at

    def _ahead(self) -> Iterator[Block]:
        """Yield blocks until a record is not followed by another, or a chunk is damaged: the walk goes on there."""
        cores = 0 if isinstance(self.pool, InlineExecutor) else len(os.sched_getaffinity(0))
        most = min(_MOST_BLOCKS_AHEAD, cores + 1)
        with closing(in_order(self._jobs(), self.pool, most, _BYTES_AHEAD)) as blocks:
            for block in blocks:
                is_too_much = any(self._take(chunk) for _, chunk in block.chunks)
                yield block
                block.give_back_memory()
                if is_too_much:
                    raise UnreadableError(_TOO_MUCH)
                if block.unsound_at is not None:
                    self._at = block.unsound_at
                    return

    def _jobs(self) -> Iterator[tuple[int, Callable[[], Block]]]:
        chunks, chunks_bytes = list[PackedChunk](), 0
        while header := self._sound_header():
            self.headers += 1
            chunk, is_outside = None, header.opcode in _OUTSIDE
            if header.opcode == Opcode.CHUNK:
                chunk = self._sound_chunk(header)
                if chunk is None:
                    break
            is_full = chunk and (
                chunks_bytes + chunk.unpacked_bytes > self._block_bytes or len(chunks) == _BLOCK_CHUNKS
            )
            if chunks and (is_outside or is_full):
                yield chunks_bytes, self._unpacking(chunks)
                chunks, chunks_bytes = [], 0
            self._at = header.end
            if chunk is not None:
                is_empty = not (chunk.unpacked_bytes or chunk.packed_bytes or chunk.crc)
                if not self._is_trace:
                    chunk, self._at = chunk.with_indexes(self._file)
                chunks += [] if is_empty else [chunk]
                chunks_bytes += chunk.unpacked_bytes
            elif is_outside:
                data, scan = self._stretch(header)
                yield len(data), partial(outside_block, data, header.offset, scan)
        if chunks:
            yield chunks_bytes, self._unpacking(chunks)

    def _unpacking(self, chunks: list[PackedChunk]) -> Callable[[], Block]:
        return partial(unpack_chunks, self._file, chunks, is_trace=self._is_trace)

    def _sound_header(self) -> RecordHeader | None:
        assert self._at is not None
        try:
            header = self._file.header_at(self._at)
        except TornRecordError:
            return None
        is_sound = _has_shape(header) and header.opcode != Opcode.FOOTER and self._fits_next(self._file, header.end)
        is_long = header.opcode != Opcode.CHUNK and header.length > MAX_RECORD_BYTES
        return header if is_sound and not is_long else None

    def _sound_chunk(self, header: RecordHeader) -> PackedChunk | None:
        with suppress(DamagedChunkError):
            chunk = PackedChunk.at(self._file, header)
            return chunk if chunk.end == header.end else None
        return None

    def _stretch(self, header: RecordHeader) -> tuple[bytes, Scan]:
        """Return as many records as follow one another from `header` on, or only its own if a later one is odd."""
        # Double the read size: few bytes are wasted when records are sparse.
        length = header.end - header.offset
        data = self._file.read(header.offset, max(length, min(self._stretch_bytes, self._file.size - header.offset)))
        scan = scan_records(data, 0, len(data), _OUTSIDE, only=True, is_trace=self._is_trace)
        self._stretch_bytes = min(max(2 * scan.end, _FIRST_STRETCH_BYTES), BLOCK_BYTES)
        if scan.has_short(data, LEAST_BYTES) or not self._fits_next(self._file, header.offset + scan.end):
            data, self._stretch_bytes = data[:length], _FIRST_STRETCH_BYTES
            scan = scan_records(data, 0, length, _OUTSIDE, only=True, is_trace=self._is_trace)
        self._at = header.offset + scan.end
        return data, scan

    def _take(self, chunk: PackedChunk) -> bool:
        """Count a chunk; return whether the file unpacks to more than is believed."""
        self._unpacked_bytes += chunk.unpacked_bytes
        self.is_unpacked &= not chunk.compression
        return self._unpacked_bytes > most_unpacked_bytes(chunk.end)

    def _step(self, at: int) -> Iterator[Block]:
        header = self._record_at(self._file, at)
        self.headers += 1
        if header is None:
            chunk, why = self._cut_chunk(at), "it is cut off" if self._torn_at(at) else "no record follows it"
            if chunk is not None and not chunk.compression:
                self.damages.append(f"the chunk at byte {at} is damaged ({why}); its records are read one by one")
                self._at, self._is_in_damage = chunk.data_offset, True
                return
            if chunk is not None:
                yield from self._damaged_chunk(chunk, why)
            self._at = self._next_record(at, chunk)
        elif header.opcode == Opcode.CHUNK:
            yield from self._chunk(header)
        else:
            yield from self._single(self._file, header)
            self._at = self._after_footer(header.end) if header.opcode == Opcode.FOOTER else header.end

    def _chunk(self, header: RecordHeader) -> Iterator[Block]:
        if int.from_bytes(self._file.peek(header.offset + 1, 8), "little") != header.length:
            self.damages.append(f"the chunk at byte {header.offset} has a wrong length; its fields have the right one")
        try:
            chunk = PackedChunk.at(self._file, header, is_cut=not self._is_trace)
        except DamagedChunkError as err:
            self._leave_out(header.offset, err)
            self._at = header.end
            return
        if self._take(chunk):
            raise UnreadableError(_TOO_MUCH)
        fits = self._fits_next(self._file, header.end)
        block = unpack_chunks(self._file, [chunk], is_trace=self._is_trace)
        is_ending_elsewhere = not (fits or chunk.crc or chunk.compression or self._is_trace)
        self._is_in_damage = block.unsound_at is not None or is_ending_elsewhere
        if not self._is_in_damage:
            self._at = header.end
            yield block
            return
        if fits or chunk.compression or self._is_trace:
            yield from self._damaged_chunk(chunk, block.unsound_why)
        self._at = self._chunk_within(chunk) or (header.end if fits else self._next_record(header.offset, chunk))

    def _chunk_within(self, chunk: PackedChunk) -> int | None:
        at = self._resume(self._file, chunk.offset, chunk.end) if chunk.compression else None
        while at is not None and self._file.peek(at, 1)[0] != Opcode.CHUNK:
            at = self._resume(self._file, at, chunk.end)
        return at

    def _cut_chunk(self, at: int) -> PackedChunk | None:
        if self._file.size - at < RECORD_HEADER.size or self._file.peek(at, 1)[0] != Opcode.CHUNK:
            return None
        try:
            header = RecordHeader(Opcode.CHUNK, at, self._file.size - at - RECORD_HEADER.size)
            chunk = PackedChunk.at(self._file, header, is_cut=True)
        except DamagedChunkError as err:
            if not self._is_trace or not self._torn_at(at):
                self._leave_out(at, err)
            return None
        return None if self._is_trace else chunk

    def _leave_out(self, at: int, why: object) -> None:
        self.damaged_chunks += 1
        self.damages.append(f"the chunk at byte {at} is damaged and left out: {why}")

    def _damaged_chunk(self, chunk: PackedChunk, why: str) -> Iterator[Block]:
        if self._is_trace:
            self._leave_out(chunk.offset, why)
            return
        self.damaged_chunks += 1
        source, count, at = Records(chunk.unpack_prefix(self._file)), 0, 0
        while True:
            header = self._record_at(source, at)
            if header is None:
                resumed_at = self._resume(source, at)
                if resumed_at is None:
                    break
                at = resumed_at
                continue
            count += header.opcode == Opcode.MESSAGE
            yield from self._single(source, header)
            at = header.end
        used = f"{counted(count, 'message')} of it {'is' if count == 1 else 'are'} used"
        self.damages.append(f"the chunk at byte {chunk.offset} is damaged ({why}); {used}")

    def _single(self, source: Records, header: RecordHeader) -> Iterator[Block]:
        if header.length > MAX_RECORD_BYTES:
            what = f"the {record_name(header.opcode)} record of {counted(header.length, 'byte')}"
            self.damages.append(f"{what} at byte {header.offset} is left out")
        elif header.opcode in _OUTSIDE:
            data = source.read(header.offset, header.end - header.offset)
            scan = single_record(header.opcode, header.length, is_trace=self._is_trace)
            is_doubtful = source is not self._file or not self._fits_next(source, header.end)
            yield Block(data, scan, header.offset, is_doubtful=is_doubtful)

    def _next_record(self, at: int, packed: PackedChunk | None = None) -> int | None:
        """Return the next record; what a chunk packs as it is, is no message outside."""
        resumed_at = self._resume(self._file, at)
        end = packed.end if packed and packed.compression else at
        while resumed_at and resumed_at < end and self._file.peek(resumed_at, 1)[0] in MESSAGES_AND_CHANNELS:
            resumed_at = self._resume(self._file, resumed_at)
        self._is_in_damage = True
        if resumed_at is not None:
            self.damages.append(f"at byte {at}: {counted(resumed_at - at, 'byte is', 'bytes are')} no record")
        elif self._is_trace:
            self.torn = self._torn_at(at) or TornRecordError(at, "no record")
        else:
            unread = f"{counted(self._file.size - end, 'byte')} of an unfinished record and " * (self._file.size > end)
            self.damages.append(f"it was not closed, or is cut off: {unread}no index")
        return resumed_at

    def _torn_at(self, at: int) -> TornRecordError | None:
        try:
            self._file.header_at(at)
        except TornRecordError as torn:
            return torn
        return None

    def _after_footer(self, at: int) -> int | None:
        self.closed = True
        end = at + len(MAGIC)
        if self._file.read(at, min(len(MAGIC), self._file.size - at)) != MAGIC:
            why = "the closing magic bytes are not there"
            self.torn = TornRecordError(at, why) if self._is_trace else None
            self.damages += [] if self._is_trace else [f"at byte {at} {why}"]
        elif end == self._file.size:
            return None
        self._is_in_damage = True
        resumed_at = None if self._is_trace else self._resume(self._file, end - 1)
        if resumed_at is not None:
            self.damages.append(f"at byte {resumed_at} records follow the end of the MCAP file")
        elif end < self._file.size:
            self.notes.append(f"the bytes from {end} on follow the end of the MCAP file and were ignored")
        return resumed_at

    def _record_at(self, source: Records, at: int) -> RecordHeader | None:
        try:
            header = source.header_at(at)
        except TornRecordError:
            header = None
        if source is self._file and (header is None or header.opcode == Opcode.CHUNK):
            return self._chunk_at(at)
        if header is None or not _has_shape(header):
            return None
        closing_bytes = MAGIC[: max(source.size - header.end, 0)]
        if header.opcode == Opcode.FOOTER and source.read(header.end, len(closing_bytes)) != closing_bytes:
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

    def _fits_next(self, source: Records, at: int) -> bool:
        try:
            header = source.header_at(at)
            is_private = header.opcode >= _PRIVATE  # as half of all bytes
            return _has_shape(source.header_at(header.end) if is_private else header)
        except TornRecordError:
            remaining = source.read(at, min(max(source.size - at, 0), RECORD_HEADER.size))
            if not remaining or (remaining == MAGIC and source is self._file):
                return True
            # A record that the end of the file cuts off.
            return remaining[0] in _OPCODES and int.from_bytes(remaining[1:], "little") <= MAX_RECORD_BYTES

    def _resume(self, source: Records, damaged_at: int, stop: int | None = None) -> int | None:
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

    def _is_record(self, source: Records, at: int) -> bool:
        try:
            header = source.header_at(at)
        except TornRecordError:
            return False
        if not _has_shape(header) or (self._is_trace and header.opcode in MESSAGES_AND_CHANNELS):
            return False
        if header.opcode == Opcode.CHUNK:
            by_its_fields = self._chunk_at(at) if source is self._file else None
            return by_its_fields is not None and by_its_fields.end == header.end
        if header.opcode == Opcode.MESSAGE:
            channel_id, _, log_ns, publish_ns = MESSAGE_HEADER.unpack(source.peek(header.content, MESSAGE_HEADER.size))
            if self.channels.get(channel_id) is None:
                self.look_ahead()
            if self.channels.get(channel_id) is None or not self.is_near(log_ns):
                return False
            if self._range_ns and self.is_near(publish_ns) and not self._fits_next(source, header.end):
                return self._resume(source, at, header.end) is None  # the last one before a damage
        return self._fits_next(source, header.end)


def _has_shape(header: RecordHeader) -> bool:
    least_bytes = LEAST_BYTES.get(Opcode(header.opcode)) if header.opcode in _OPCODES else None
    if least_bytes is None:
        return header.opcode >= _PRIVATE
    return header.length == least_bytes if header.opcode in _EXACT else header.length >= least_bytes
