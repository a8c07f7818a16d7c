"""Records of a MCAP file in blocks of about two megabytes, each unpacked, checked and sorted by a job in any thread."""

from __future__ import annotations

from bisect import bisect
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from mcap.opcode import Opcode

from ..format.encoding import MESSAGE_HEADER
from .chunks import DamagedChunkError, PackedChunk, UnpackMemory
from .file import RecordFile
from .records import Buffer
from .scan import ChannelEvents, Scan, scan_indexed, scan_records, split_by_channel

BLOCK_BYTES = 2 << 20
"""Small chunks are read together up to this size."""

BLOCK_STEPS = 120
"""Cost of a block besides its records, in steps over one record."""

CHUNK_STEPS = 40
"""Cost of a chunk besides its records."""

LARGEST_FILE_RATIO = 200
"""Most bytes that all chunks up to an offset may unpack to, per byte of the file up to there."""

LEAST_BYTES = {
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
"""Least length of each kind of record."""

_UNSUSPECTED_FILE_BYTES = 256 << 20
_MOST_REUSED_BYTES = 4 * BLOCK_BYTES  # memory that grew beyond this is dropped

_FREE: deque[UnpackMemory] = deque(maxlen=8)
"""Memory for the next block of any file: touching fresh memory was a fifth of reading lz4. `append` and `pop` are atomic."""


def most_unpacked_bytes(end: int, ratio: int = LARGEST_FILE_RATIO) -> int:
    return max(_UNSUSPECTED_FILE_BYTES, ratio * end)


@dataclass(frozen=True, slots=True)
class Block:
    """Records of neighbouring chunks, or, with no chunk, records outside of chunks from `at` in the file on.

    Attributes:
        chunks: each chunk, and the offset of its records in `data`.
        unsound_at, unsound_why: offset in the file of the first chunk that cannot be believed; it and later ones are left out.
        is_doubtful: a record out of a damaged chunk.
    """

    data: Buffer
    scan: Scan
    at: int = 0
    chunks: Sequence[tuple[int, PackedChunk]] = ()
    events: list[ChannelEvents] = field(default_factory=list)
    memory: UnpackMemory | None = None
    unsound_at: int | None = None
    unsound_why: str = ""
    is_doubtful: bool = False

    @property
    def steps(self) -> int:
        return BLOCK_STEPS + CHUNK_STEPS * len(self.chunks) + self.scan.steps

    def offset(self, position: int) -> int:
        """Return where a record is in the file: of one in a chunk, the chunk."""
        if not self.chunks:
            return self.at + position
        return self.chunks[bisect(self.chunks, position, key=itemgetter(0)) - 1][1].offset

    def give_back_memory(self) -> None:
        if self.memory and self.memory.size <= _MOST_REUSED_BYTES:
            _FREE.append(self.memory)


def unpack_chunks(file: RecordFile, chunks: list[PackedChunk], *, is_trace: bool) -> Block:
    """Unpack chunks up to the first that is damaged; one without a CRC is, if it has other records, unless it is of a trace of ours."""
    memory = _free_memory()
    data = memory.records(sum(chunk.unpacked_bytes for chunk in chunks))
    scan, sound, start, unsound_at, why = Scan(), list[tuple[int, PackedChunk]](), 0, None, ""
    for chunk in chunks:
        stop = start + chunk.unpacked_bytes
        try:
            chunk_scan = _scan_chunk(file, chunk, memory, start, is_trace=is_trace)
        except DamagedChunkError as err:
            unsound_at, why = chunk.offset, str(err)
            break
        scan.extend(chunk_scan)
        sound.append((start, chunk))
        start = stop
    events = split_by_channel(scan.events(data)) if scan.runs else []
    return Block(data, scan, 0, sound, events, memory, unsound_at, why)


def _scan_chunk(file: RecordFile, chunk: PackedChunk, memory: UnpackMemory, start: int, *, is_trace: bool) -> Scan:
    stop = start + chunk.unpacked_bytes
    chunk.unpack(file, memory, start)
    data = memory.records(stop)
    indexed = None if is_trace else scan_indexed(data, start, stop, chunk.indexed_starts(file) + start)
    scan = indexed or scan_records(data, start, stop, is_trace=is_trace)
    if not chunk.crc and scan.end < stop:
        raise DamagedChunkError("a record in it is cut off")
    if not (chunk.crc or is_trace) and (scan.skipped or scan.has_short(data, LEAST_BYTES)):
        raise DamagedChunkError("a record in it is damaged")
    return scan


def outside_block(data: bytes, at: int, scan: Scan) -> Block:
    return Block(data, scan, at, (), split_by_channel(scan.events(data)) if scan.runs else [])


def _free_memory() -> UnpackMemory:
    try:
        return _FREE.pop()
    except IndexError:
        return UnpackMemory()
