"""Chunks of a MCAP file, unpacked and checked with bounded memory."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import cramjam
import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from dds_trace.base.units import counted

from ..format.encoding import RECORD_HEADER
from .file import MAX_RECORD_BYTES, RecordFile, RecordHeader
from .records import RecordContent, crc32

_HEADER_BYTES = 64  # all fields before the records

LARGEST_RATIO = 1000
"""Most unpacked bytes per packed byte; events pack 5 to 30 times, and a larger claim may be an attack."""

_UNSUSPECTED_BYTES = 32 << 20  # any ratio up to here: a blank image packs better; a whole file has a bound of its own

_MOST_LZ4_RATIO = 255
_PREFIX_STEP_BYTES = 1024  # at most this unpacks to 64 MiB more than is allowed

_INDEX = struct.Struct("<BQHI")
"""Header of a MessageIndex record, channel id, bytes of its entries: pairs of log time and offset."""

_INDEX_BYTES, _ENTRY_BYTES = 6, 16
_FIRST_INDEX_BYTES = 4096
_MOST_INDEX_HEADERS = 1 << 20  # bytes, of 65,536 channels; an entry is shorter than a message

_thread_local = threading.local()


class DamagedChunkError(Exception):
    """A chunk that cannot be unpacked, or has other records than were written."""


@dataclass(frozen=True, slots=True)
class PackedChunk:
    offset: int
    data_offset: int
    packed_bytes: int
    unpacked_bytes: int
    crc: int
    compression: str
    claimed_bytes: int
    indexed_bytes: int = 0
    """Bytes of message indexes after the chunk."""

    @property
    def end(self) -> int:
        return self.data_offset + self.packed_bytes

    @classmethod
    def at(cls, file: RecordFile, header: RecordHeader, *, is_cut: bool = False) -> PackedChunk:
        """Read the header of a chunk; of one that `is_cut` off, the packed bytes are all that are there."""
        content = RecordContent(file.peek(header.content, min(_HEADER_BYTES, header.length)))
        try:
            content.read(16)  # first and last log time
            claimed_bytes, crc = content.read8(), content.read4()
            compression, packed_bytes = content.read_prefixed_string(), content.read8()
        except ValueError as err:
            raise DamagedChunkError(f"its header is damaged ({err})") from err
        data_offset = header.content + content.count
        packed_bytes = max(header.end - data_offset, 0) if is_cut else packed_bytes
        if packed_bytes > header.end - data_offset:
            raise DamagedChunkError(f"it claims {counted(packed_bytes, 'packed byte')}, more than its record has")
        possible_bytes = min(MAX_RECORD_BYTES, max(_UNSUSPECTED_BYTES, LARGEST_RATIO * packed_bytes))
        unpacked_bytes = min(claimed_bytes, possible_bytes) if is_cut else claimed_bytes  # costs no message
        _check_claims(compression, packed_bytes, unpacked_bytes)
        return cls(header.offset, data_offset, packed_bytes, unpacked_bytes, crc, compression, claimed_bytes)

    def unpack(self, file: RecordFile, memory: UnpackMemory | None = None, at: int = 0) -> memoryview:
        """Unpack to position `at` of `memory.records`; threads may do so at once, each into its own memory."""
        memory = memory or UnpackMemory()
        try:
            target = memory.records(at + self.unpacked_bytes)[at:]
            unpacked_bytes = self._unpack_into(target, file, memory)
        except (ValueError, MemoryError, zstandard.ZstdError, cramjam.DecompressionError) as err:
            raise DamagedChunkError(f"it cannot be unpacked ({err})") from err
        if unpacked_bytes != self.claimed_bytes:
            more = "more than " * (unpacked_bytes == self.unpacked_bytes < self.claimed_bytes)
            raise DamagedChunkError(
                f"it claims {counted(self.claimed_bytes, 'byte')} and holds {more}{unpacked_bytes:,}"
            )
        if self.crc and crc32(target) != self.crc:
            raise DamagedChunkError("its CRC does not match")
        return target

    def with_indexes(self, file: RecordFile) -> tuple[PackedChunk, int]:
        """Return the chunk with the indexes after it, and where the last one begins: those before it are sound, as another follows each."""
        at = last_at = data_at = self.end
        data, size = b"", _FIRST_INDEX_BYTES
        while True:
            if at + RECORD_HEADER.size > data_at + len(data):
                data, data_at = file.read(at, min(size, max(file.size - at, 0))), at
                size = min(2 * size, _MOST_INDEX_HEADERS)
            if len(data) < RECORD_HEADER.size:
                break
            opcode, length = RECORD_HEADER.unpack_from(data, at - data_at)
            if opcode != Opcode.MESSAGE_INDEX or not _INDEX_BYTES <= length <= MAX_RECORD_BYTES:
                break
            last_at, at = at, at + RECORD_HEADER.size + length
        indexed_bytes = min(at, file.size) - self.end
        is_likely = indexed_bytes < self.unpacked_bytes + _MOST_INDEX_HEADERS
        return replace(self, indexed_bytes=indexed_bytes * is_likely), last_at

    def indexed_starts(self, file: RecordFile) -> NDArray[np.int64]:
        """Return where messages begin in the chunk as its indexes say, which may be wrong; nothing where one is odd."""
        data, at, parts = file.read(self.end, self.indexed_bytes), 0, [np.empty(0, np.int64)]
        while at < len(data):
            _, length, _, entries_bytes = (
                _INDEX.unpack_from(data, at) if len(data) - at >= _INDEX.size else (0, 0, 0, 1)
            )
            is_whole = length <= len(data) - at - RECORD_HEADER.size
            if not is_whole or length != entries_bytes + _INDEX_BYTES or entries_bytes % _ENTRY_BYTES:
                return parts[0]
            parts.append(np.frombuffer(data, "<i8", entries_bytes // 8, at + _INDEX.size)[1::2])
            at += RECORD_HEADER.size + length
        starts = np.concatenate(parts)
        return starts[(starts >= 0) & (starts <= self.unpacked_bytes)]

    def unpack_prefix(self, file: RecordFile) -> bytes:
        packed = file.read(self.data_offset, self.packed_bytes)
        if self.compression == "zstd":
            return _zstd_prefix(packed)
        if not self.compression:
            return packed
        target = bytearray(min(max(self.unpacked_bytes, _MOST_LZ4_RATIO * len(packed)), MAX_RECORD_BYTES))
        with suppress(ValueError, cramjam.DecompressionError):
            _unpack_lz4_into(memoryview(packed), memoryview(target))
        return bytes(target)

    def _unpack_into(self, target: memoryview, file: RecordFile, memory: UnpackMemory) -> int:
        if not self.compression:
            file.read_into(target[: self.packed_bytes], self.data_offset)
            return self.packed_bytes
        packed = memory.packed(self.packed_bytes)
        file.read_into(packed, self.data_offset)
        return _UNPACKERS[self.compression](packed, target)


def unpack_records(compression: str, packed: bytes, unpacked_bytes: int) -> bytes | bytearray:
    """Unpack a chunk that another reader has taken out of its file."""
    _check_claims(compression, len(packed), unpacked_bytes)
    if not compression:
        return packed
    target = bytearray(unpacked_bytes)
    try:
        size_bytes = _UNPACKERS[compression](memoryview(packed), memoryview(target))
    except (ValueError, MemoryError, zstandard.ZstdError, cramjam.DecompressionError) as err:
        raise DamagedChunkError(f"it cannot be unpacked ({err})") from err
    if size_bytes != unpacked_bytes:
        raise DamagedChunkError(f"it holds {counted(size_bytes, 'byte')} and claims {unpacked_bytes:,}")
    return target


def _check_claims(compression: str, packed_bytes: int, unpacked_bytes: int) -> None:
    if max(unpacked_bytes, packed_bytes) > MAX_RECORD_BYTES:
        raise DamagedChunkError(
            f"it claims {unpacked_bytes:,} bytes; at most {MAX_RECORD_BYTES:,} are read at once "
            "(a file that really has such chunks can be rewritten by `mcap compress`)"
        )
    if unpacked_bytes > max(_UNSUSPECTED_BYTES, LARGEST_RATIO * packed_bytes):
        raise DamagedChunkError(f"it claims {unpacked_bytes:,} bytes, packed into {packed_bytes:,}")
    if compression and compression not in _UNPACKERS:
        raise DamagedChunkError(f"its compression {compression!r} is not known")


class UnpackMemory:
    """Memory for one chunk after the other: fresh memory is slow at its first touch."""

    def __init__(self) -> None:
        self._packed = bytearray()
        self._records = bytearray()

    def packed(self, size: int) -> memoryview:
        if len(self._packed) < size:
            self._packed = bytearray(size)
        return memoryview(self._packed)[:size]

    def records(self, size: int) -> memoryview:
        if len(self._records) < size:
            self._records = bytearray(size)
        return memoryview(self._records)[:size]

    @property
    def size(self) -> int:
        return len(self._packed) + len(self._records)


def unpack_zstd(packed: bytes, limit_bytes: int) -> bytes:
    """Unpack the first `limit_bytes` bytes of zstd frames, in no more memory than that."""
    with _zstd().stream_reader(packed, read_across_frames=True) as stream:
        return stream.read(limit_bytes)


def _zstd_prefix(packed: bytes) -> bytes:
    unpacker, parts, left_bytes = _zstd().decompressobj(), list[bytes](), MAX_RECORD_BYTES
    with suppress(zstandard.ZstdError):
        for at in range(0, len(packed), _PREFIX_STEP_BYTES):
            parts.append(unpacker.decompress(packed[at : at + _PREFIX_STEP_BYTES]))
            left_bytes -= len(parts[-1])
            if left_bytes < 0 or unpacker.eof:
                break
    return b"".join(parts)


def _unpack_zstd_into(packed: memoryview, target: memoryview) -> int:
    # One frame that fits is unpacked straight into `target`.
    with _zstd().stream_reader(packed, read_across_frames=True) as stream:
        return stream.readinto(target)


def _unpack_lz4_into(packed: memoryview, target: memoryview) -> int:
    return cramjam.lz4.decompress_into(packed, target)


def _zstd() -> zstandard.ZstdDecompressor:
    """Return this thread's unpacker; making one takes longer than unpacking a small chunk."""
    if not hasattr(_thread_local, "zstd"):
        _thread_local.zstd = zstandard.ZstdDecompressor()
    unpacker: zstandard.ZstdDecompressor = _thread_local.zstd
    return unpacker


_UNPACKERS: dict[str, Callable[[memoryview, memoryview], int]] = {"zstd": _unpack_zstd_into, "lz4": _unpack_lz4_into}
"""Functions that unpack into a buffer and return the number of bytes."""
