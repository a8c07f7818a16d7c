"""A MCAP file cut into blocks of about two megabytes, each a job that unpacks, checks and sorts its records.

Headers are walked from front to back, without an index, which might be wrong. The summary serves only to resume after a
damaged record.
"""

from __future__ import annotations

from bisect import bisect
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

from mcap.opcode import Opcode

from dds_trace.base.units import counted

from ..format.encoding import MAGIC
from .chunks import DamagedChunkError, PackedChunk, UnpackMemory
from .file import MAX_RECORD_BYTES, RecordFile, RecordHeader, Summary, TornRecordError
from .records import Buffer, record_name
from .scan import MESSAGES_AND_CHANNELS, ChannelEvents, Scan, scan_records, split_by_channel

BLOCK_BYTES = 2 << 20
"""Small chunks are read together up to this size."""

BLOCK_STEPS = 120
"""Cost of a block besides its records, in steps over one record."""

CHUNK_STEPS = 40
"""Cost of a chunk besides its records."""

LARGEST_FILE_RATIO = 200
"""Most bytes that all chunks up to an offset may unpack to, per byte of the file up to there."""

_UNSUSPECTED_FILE_BYTES = 256 << 20


def most_unpacked_bytes(end: int) -> int:
    return max(_UNSUSPECTED_FILE_BYTES, LARGEST_FILE_RATIO * end)


_WALKED = MESSAGES_AND_CHANNELS | {Opcode.CHUNK, Opcode.DATA_END, Opcode.FOOTER}
_FIRST_STRETCH_BYTES = 4096
_BLOCK_CHUNKS = 1000
_MOST_REUSED_BYTES = 4 * BLOCK_BYTES  # memory that grew beyond this is dropped

_FREE: deque[UnpackMemory] = deque(maxlen=8)
"""Memory for the next block of any file: touching fresh memory was a fifth of reading lz4. `append` and `pop` are atomic."""


@dataclass(frozen=True, slots=True)
class Block:
    """Records of neighbouring chunks, or a stretch of records outside of chunks, taken apart."""

    data: Buffer
    scan: Scan
    starts: list[tuple[int, int]]
    chunked: bool
    events: list[ChannelEvents]
    notes: list[str] = field(default_factory=list)
    memory: UnpackMemory | None = None
    chunks: int = 0

    @property
    def steps(self) -> int:
        return BLOCK_STEPS + CHUNK_STEPS * self.chunks + self.scan.steps

    def offset(self, position: int) -> int:
        start, offset = self.starts[bisect(self.starts, position, key=lambda start: start[0]) - 1]
        return offset if self.chunked else offset + position - start


@dataclass(slots=True)
class BlockJobs:
    file: RecordFile
    summary: Summary | None
    notes: list[str] = field(default_factory=list)
    truncated: str | None = None
    suspicion: str = ""
    closed: bool = False
    torn_bytes: int = 0
    damaged_chunks: int = 0
    skipped_bytes: int = 0
    _chunks: list[PackedChunk] = field(default_factory=list)
    _chunks_bytes: int = 0
    _unpacked_bytes: int = 0
    _stretch_bytes: int = _FIRST_STRETCH_BYTES
    _at: int = 0
    _chunk_offsets: list[int] | None = None

    def take_back(self, block: Block) -> None:
        if block.memory and block.memory.size <= _MOST_REUSED_BYTES:
            _FREE.append(block.memory)

    def __iter__(self) -> Iterator[tuple[int, Callable[[], Block]]]:
        """Yield (size in bytes, job) of each block; a job may run in any thread."""
        for header in self._headers():
            if header.opcode == Opcode.CHUNK:
                yield from self._add_chunk(header)
            elif header.opcode in MESSAGES_AND_CHANNELS:
                yield from self._chunks_so_far()
                yield from self._outside(header)
        yield from self._chunks_so_far()

    def _headers(self) -> Iterator[RecordHeader]:
        self._at = self.file.data_start
        data_ended = False
        while True:
            header = self._next_header()
            if header is None:
                return
            self._at = header.end
            if header.opcode == Opcode.FOOTER:
                self._check_end(header.end)
                return
            data_ended = data_ended or header.opcode == Opcode.DATA_END
            if not data_ended:
                yield header

    def _next_header(self) -> RecordHeader | None:
        while True:
            try:
                header = self.file.header_at(self._at, _WALKED)
            except TornRecordError as torn:
                self.skipped_bytes += torn.offset - self._at
                resumed_at = self._resume_after(torn)
            else:
                self.skipped_bytes += header.offset - self._at
                return header
            if resumed_at is None:
                return None
            self._at = resumed_at

    def _outside(self, header: RecordHeader) -> Iterator[tuple[int, Callable[[], Block]]]:
        if header.length > MAX_RECORD_BYTES:
            name = record_name(header.opcode)
            self.notes.append(
                f"the {name} record of {counted(header.length, 'byte')} at byte {header.offset} is left out"
            )
            return
        # Double the read size: few bytes are wasted when records are sparse.
        size = max(header.end - header.offset, min(self._stretch_bytes, self.file.size - header.offset))
        data = self.file.read(header.offset, size)
        scan = scan_records(data, 0, len(data), only=True)
        self._stretch_bytes = min(max(2 * scan.end, _FIRST_STRETCH_BYTES), BLOCK_BYTES)
        self._at = header.offset + scan.end
        yield len(data), partial(_outside_block, data, scan, header.offset)

    def _add_chunk(self, header: RecordHeader) -> Iterator[tuple[int, Callable[[], Block]]]:
        try:
            chunk = PackedChunk.at(self.file, header)
        except DamagedChunkError as err:
            self.notes.append(_left_out(header.offset, err))
            self.damaged_chunks += 1
            return
        if not (chunk.unpacked_bytes or chunk.packed_bytes or chunk.crc):
            return
        unpacked_bytes = self._unpacked_bytes + chunk.unpacked_bytes
        if unpacked_bytes > most_unpacked_bytes(header.end):
            why = f"with it the file unpacks to more than {LARGEST_FILE_RATIO} times its size"
            self.notes.append(_left_out(header.offset, why))
            self.suspicion = "it unpacks to far more than a recorder packs into so few bytes"
            return
        self._unpacked_bytes = unpacked_bytes
        if self._chunks_bytes + chunk.unpacked_bytes > BLOCK_BYTES or len(self._chunks) == _BLOCK_CHUNKS:
            yield from self._chunks_so_far()
        self._chunks.append(chunk)
        self._chunks_bytes += chunk.unpacked_bytes

    def _chunks_so_far(self) -> Iterator[tuple[int, Callable[[], Block]]]:
        if self._chunks:
            yield self._chunks_bytes, partial(self._unpack, self._chunks)
            self._chunks, self._chunks_bytes = [], 0

    def _unpack(self, chunks: list[PackedChunk]) -> Block:
        memory = _free_memory()
        data = memory.records(sum(chunk.unpacked_bytes for chunk in chunks))
        scan, starts, notes, start = Scan(), [(0, 0)], list[str](), 0
        for chunk in chunks:
            stop = start + chunk.unpacked_bytes
            try:
                chunk.unpack(self.file, memory, start)
            except DamagedChunkError as err:
                notes.append(_left_out(chunk.offset, err))
                continue
            chunk_scan = scan_records(data, start, stop)
            if chunk_scan.end < stop:
                notes.append(
                    _left_out(
                        chunk.offset,
                        counted(stop - chunk_scan.end, "byte in it is no record", "bytes in it are no records"),
                    )
                )
                continue
            scan.extend(chunk_scan)
            starts.append((start, chunk.offset))
            start = stop
        return Block(data, scan, starts, True, split_by_channel(scan.events(data)), notes, memory, len(chunks))

    def _resume_after(self, torn: TornRecordError) -> int | None:
        if self.summary is None:
            self.torn_bytes = max(self.file.size - torn.offset, 0)
            self.truncated = f"ends early, {torn}; everything complete before it is used"
            return None
        if self._chunk_offsets is None:
            self._chunk_offsets = self.summary.chunk_offsets()
        following = bisect(self._chunk_offsets, torn.offset)
        resumed_at = self._chunk_offsets[following] if following < len(self._chunk_offsets) else None
        end = self.summary.data_end if resumed_at is None else resumed_at
        self.notes.append(f"damaged at {torn}; nothing is read from there up to byte {end}")
        return resumed_at

    def _check_end(self, at: int) -> None:
        self.closed = True
        if self.file.read(at, min(len(MAGIC), self.file.size - at)) != MAGIC:
            self.truncated = f"ends early, byte {at}: the closing magic bytes are not there; every record is"
        elif at + len(MAGIC) < self.file.size:
            self.notes.append(f"the bytes from {at + len(MAGIC)} on follow the end of the MCAP file and were ignored")


def _free_memory() -> UnpackMemory:
    try:
        return _FREE.pop()
    except IndexError:
        return UnpackMemory()


def _outside_block(data: bytes, scan: Scan, offset: int) -> Block:
    return Block(data, scan, [(0, offset)], False, split_by_channel(scan.events(data)))


def _left_out(offset: int, why: object) -> str:
    return f"the chunk at byte {offset} is damaged and left out: {why}"
