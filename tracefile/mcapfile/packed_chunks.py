"""A chunk of a MCAP file: where it lies, and its records unpacked and checked, never larger than they may be."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cramjam
import zstandard

from ..format.crc import crc32
from ..units.counts import counted
from .records import MAX_RECORD_BYTES, Fields

if TYPE_CHECKING:
    from collections.abc import Callable

    from .records import RecordFile, RecordHeader

_HEADER_BYTES = 64  # all fields before the records, with room for the name of any compression that we know

LARGEST_RATIO = 1000
"""Events pack 5 to 30 times. What grows more than this may be made to keep a reader busy for hours."""

_UNSUSPECTED_BYTES = 1 << 20  # a blank image packs better still, and costs nothing

_of_thread = threading.local()


class DamagedChunkError(Exception):
    """A chunk's records cannot be had; the text says why."""


@dataclass(frozen=True, slots=True)
class PackedChunk:
    """Where a chunk's records lie and what it says of them.

    Attributes:
        offset: of the chunk record in the file.
        data_offset: of its packed records in the file.
        packed_bytes: their length in the file.
        unpacked_bytes: their length once unpacked, as claimed.
        crc: CRC-32 of the unpacked records; 0 if the writer made none.
        compression: `zstd`, `lz4` or empty.
    """

    offset: int
    data_offset: int
    packed_bytes: int
    unpacked_bytes: int
    crc: int
    compression: str

    @classmethod
    def at(cls, file: RecordFile, header: RecordHeader) -> PackedChunk:
        """The chunk of which `header` is the record.

        Raises:
            DamagedChunkError: its fields are not as MCAP has them, or claim more than a chunk may hold.
        """
        take = Fields(file.read(header.content, min(_HEADER_BYTES, header.length)))
        try:
            take.raw(16)  # first and last log time
            unpacked_bytes, crc, compression, packed_bytes = take.u64(), take.u32(), take.text(), take.u64()
        except ValueError as err:
            raise DamagedChunkError(f"its header is damaged ({err})") from err
        data_offset = header.content + take.position
        if packed_bytes > header.end - data_offset:
            raise DamagedChunkError(f"it claims {packed_bytes} packed bytes, more than its record has")
        if max(unpacked_bytes, packed_bytes) > MAX_RECORD_BYTES:
            raise DamagedChunkError(
                f"it claims {unpacked_bytes} bytes; at most {MAX_RECORD_BYTES} are read at once "
                "(a file that really has such chunks can be written anew by `mcap compress`)",
            )
        if unpacked_bytes > max(_UNSUSPECTED_BYTES, LARGEST_RATIO * packed_bytes):
            raise DamagedChunkError(f"it claims {unpacked_bytes} bytes, packed into {packed_bytes}")
        if compression and compression not in _UNPACKERS:
            raise DamagedChunkError(f"its compression {compression!r} is not known")
        return cls(header.offset, data_offset, packed_bytes, unpacked_bytes, crc, compression)

    def unpack(self, file: RecordFile, memory: UnpackMemory | None = None, at: int = 0) -> memoryview:
        """The chunk's records; any number of threads may unpack chunks of one file, each with memory of its own.

        Args:
            file: where the chunk is.
            memory: to unpack into; what is returned lies in it, and is gone when it is used again.
            at: where in `memory.records` to begin.

        Raises:
            DamagedChunkError: they cannot be unpacked, or are not those that were written.
        """
        memory = memory or UnpackMemory()
        try:
            room = memory.records(at + self.unpacked_bytes)[at:]
            found = self._unpack_into(room, file, memory)
        except (ValueError, MemoryError, zstandard.ZstdError, cramjam.DecompressionError) as err:
            raise DamagedChunkError(f"it cannot be unpacked ({err})") from err
        if found != self.unpacked_bytes:
            raise DamagedChunkError(f"it holds {counted(found, 'byte')} and claims {self.unpacked_bytes}")
        if self.crc and crc32(room) != self.crc:
            raise DamagedChunkError("its CRC does not match")
        return room

    def _unpack_into(self, room: memoryview, file: RecordFile, memory: UnpackMemory) -> int:
        if not self.compression:
            file.read_into(room[: self.packed_bytes], self.data_offset)
            return self.packed_bytes
        packed = memory.packed(self.packed_bytes)
        file.read_into(packed, self.data_offset)
        return _UNPACKERS[self.compression](packed, room)


class UnpackMemory:
    """Memory that chunks are unpacked into, one after the other: fresh memory is slow at its first touch."""

    def __init__(self) -> None:
        self._packed = bytearray()
        self._records = bytearray()

    def packed(self, size: int) -> memoryview:
        """Room for the bytes of the file; what was there before is overwritten."""
        if len(self._packed) < size:
            self._packed = bytearray(size)
        return memoryview(self._packed)[:size]

    def records(self, size: int) -> memoryview:
        """Room for the unpacked records; asked for more than ever before, it is new room, and empty."""
        if len(self._records) < size:
            self._records = bytearray(size)
        return memoryview(self._records)[:size]

    @property
    def size(self) -> int:
        """Bytes held."""
        return len(self._packed) + len(self._records)


def unpack_zstd(packed: bytes, limit_bytes: int) -> bytes:
    """The first `limit_bytes` bytes of what zstd frames hold; no more memory than that is taken.

    Raises:
        ZstdError: no zstd frame, or a damaged one.
    """
    with _zstd().stream_reader(packed, read_across_frames=True) as stream:
        return stream.read(limit_bytes)


def _unpack_zstd_into(packed: memoryview, room: memoryview) -> int:
    # One frame that fits is unpacked straight into `room`.
    with _zstd().stream_reader(packed, read_across_frames=True) as stream:
        return stream.readinto(room)


def _unpack_lz4_into(packed: memoryview, room: memoryview) -> int:
    return cramjam.lz4.decompress_into(packed, room)


def _zstd() -> zstandard.ZstdDecompressor:
    """This thread's own: making one takes longer than unpacking a small chunk with it."""
    if not hasattr(_of_thread, "zstd"):
        _of_thread.zstd = zstandard.ZstdDecompressor()
    own: zstandard.ZstdDecompressor = _of_thread.zstd
    return own


_UNPACKERS: dict[str, Callable[[memoryview, memoryview], int]] = {
    "zstd": _unpack_zstd_into,
    "lz4": _unpack_lz4_into,
}
"""Each unpacks into the room that is for it, and says how many bytes it found for it."""
