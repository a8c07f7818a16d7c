"""A chunk of a MCAP file: where it lies, and its records unpacked and checked, never larger than they may be."""

from __future__ import annotations

import threading
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lz4.frame
import zstandard

from tracefile.records import MAX_RECORD_BYTES, Fields

if TYPE_CHECKING:
    from collections.abc import Callable

    from tracefile.records import RecordFile, RecordHeader

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
        if compression not in _UNPACKERS:
            raise DamagedChunkError(f"its compression {compression!r} is not known")
        return cls(header.offset, data_offset, packed_bytes, unpacked_bytes, crc, compression)

    def unpack(self, file: RecordFile) -> bytes:
        """The chunk's records; any number of threads may unpack chunks of one file.

        Raises:
            DamagedChunkError: they cannot be unpacked, or are not those that were written.
        """
        packed = file.read(self.data_offset, self.packed_bytes)
        try:
            data = _UNPACKERS[self.compression](packed, self.unpacked_bytes)
        except (RuntimeError, EOFError, ValueError, MemoryError, zstandard.ZstdError) as err:
            raise DamagedChunkError(f"it cannot be unpacked ({err})") from err
        if len(data) != self.unpacked_bytes:
            raise DamagedChunkError(f"it holds {len(data)} bytes and claims {self.unpacked_bytes}")
        if self.crc and zlib.crc32(data) != self.crc:
            raise DamagedChunkError("its CRC does not match")
        return data


def unpack_zstd(packed: bytes, limit_bytes: int) -> bytes:
    """The first `limit_bytes` bytes of what zstd frames hold; no more memory than that is taken.

    Raises:
        ZstdError: no zstd frame, or a damaged one.
    """
    # `decompress` takes the frame's own word for the memory it needs, so that has to be looked at first.
    if zstandard.frame_content_size(packed) == limit_bytes:
        return _zstd().decompress(packed)
    with _zstd().stream_reader(packed, read_across_frames=True) as stream:
        return stream.read(limit_bytes)


def _zstd() -> zstandard.ZstdDecompressor:
    """This thread's own: making one takes longer than unpacking a small chunk with it."""
    if not hasattr(_of_thread, "zstd"):
        _of_thread.zstd = zstandard.ZstdDecompressor()
    own: zstandard.ZstdDecompressor = _of_thread.zstd
    return own


def _unpack_lz4(packed: bytes, unpacked_bytes: int) -> bytes:
    if not hasattr(_of_thread, "lz4"):
        _of_thread.lz4 = lz4.frame.create_decompression_context()
    lz4.frame.reset_decompression_context(_of_thread.lz4)
    data: bytes = lz4.frame.decompress_chunk(_of_thread.lz4, packed, max_length=unpacked_bytes)[0]
    return data


def _unpack_nothing(packed: bytes, _unpacked_bytes: int) -> bytes:
    return packed


_UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {
    "": _unpack_nothing,
    "zstd": unpack_zstd,
    "lz4": _unpack_lz4,
}
