"""MCAP's records as they lie in a file: what each opcode holds, and a walker that trusts no length.

The tables follow the MCAP specification (https://mcap.dev/spec). `read_records` hands out every record of a
file, chunks opened; the event reader uses only `RecordFile` and the tables, and treats events as arrays.
"""

from __future__ import annotations

import os
import stat
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from mcap.opcode import Opcode

from ..errors import TraceFormatError
from ..format.event_record import RECORD_HEADER
from ..units.counts import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

Buffer: TypeAlias = "bytes | memoryview"

MAGIC = b"\x89MCAP0\r\n"

MAX_RECORD_BYTES = 64 << 20
"""A record that we hold in memory whole is at most this long, packed or unpacked; writers' chunks are 0.7-8 MB."""

_MAX_MAP_BYTES = 1 << 20  # more than an entry for each of the 65,536 channels that a file can have


class Fields:
    """Takes the fields of one record's content, first to last; bytes that are left over are no fault.

    Raises:
        ValueError: a field reaches beyond the content, or text is not UTF-8.
    """

    __slots__ = ("_at", "_data")

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self._at = 0

    @property
    def position(self) -> int:
        """How many bytes were taken so far."""
        return self._at

    def raw(self, size: int) -> bytes:
        """The next `size` bytes."""
        end = self._at + size
        if end > len(self._data):
            raise ValueError(f"a field of {counted(size, 'byte')} reaches beyond its record")
        taken = bytes(self._data[self._at : end])
        self._at = end
        return taken

    def rest(self) -> bytes:
        """All that is left."""
        return self.raw(len(self._data) - self._at)

    def u8(self) -> int:
        """Unsigned, 1 byte."""
        return self.raw(1)[0]

    def u16(self) -> int:
        """Unsigned, 2 bytes, little-endian; so are all numbers of the format."""
        return int.from_bytes(self.raw(2), "little")

    def u32(self) -> int:
        """Unsigned, 4 bytes."""
        return int.from_bytes(self.raw(4), "little")

    def u64(self) -> int:
        """Unsigned, 8 bytes."""
        return int.from_bytes(self.raw(8), "little")

    def text(self) -> str:
        """UTF-8 with its length before it."""
        return self.raw(self.u32()).decode()

    def short_bytes(self) -> bytes:
        """Bytes with a 4-byte length before them."""
        return self.raw(self.u32())

    def long_bytes(self) -> bytes:
        """Bytes with an 8-byte length before them."""
        return self.raw(self.u64())

    def text_map(self) -> dict[str, str]:
        """Text to text."""
        inner = self._map()
        return {key: inner.text() for key in inner.until_end(Fields.text)}

    def count_map(self) -> dict[int, int]:
        """Channel id to a count or an offset."""
        inner = self._map()
        return {key: inner.u64() for key in inner.until_end(Fields.u16)}

    def time_offsets(self) -> list[tuple[int, int]]:
        """Pairs of log time and offset."""
        inner = Fields(self.short_bytes())
        return [(time, inner.u64()) for time in inner.until_end(Fields.u64)]

    def _map(self) -> Fields:
        content = self.short_bytes()
        if len(content) > _MAX_MAP_BYTES:
            raise ValueError(f"a map of {len(content)} bytes")
        return Fields(content)

    def until_end(self, take: Callable[[Fields], Any]) -> Iterator[Any]:
        """`take` again and again until nothing is left."""
        while self._at < len(self._data):
            yield take(self)


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """A record's name and its fields, each with the function that takes it, in the order of the file."""

    name: str
    fields: tuple[tuple[str, Callable[[Fields], Any]], ...]

    def parse(self, content: bytes | memoryview) -> dict[str, Any]:
        """The fields of one record by name; `ValueError` as for `Fields`."""
        take = Fields(content)
        return {name: read(take) for name, read in self.fields}


LAYOUTS = {
    Opcode.HEADER: RecordLayout("Header", (("profile", Fields.text), ("library", Fields.text))),
    Opcode.FOOTER: RecordLayout(
        "Footer",
        (("summary_start", Fields.u64), ("summary_offset_start", Fields.u64), ("summary_crc", Fields.u32)),
    ),
    Opcode.SCHEMA: RecordLayout(
        "Schema",
        (("id", Fields.u16), ("name", Fields.text), ("encoding", Fields.text), ("data", Fields.short_bytes)),
    ),
    Opcode.CHANNEL: RecordLayout(
        "Channel",
        (
            ("id", Fields.u16),
            ("schema_id", Fields.u16),
            ("topic", Fields.text),
            ("message_encoding", Fields.text),
            ("metadata", Fields.text_map),
        ),
    ),
    Opcode.MESSAGE: RecordLayout(
        "Message",
        (
            ("channel_id", Fields.u16),
            ("sequence", Fields.u32),
            ("log_time", Fields.u64),
            ("publish_time", Fields.u64),
            ("data", Fields.rest),
        ),
    ),
    Opcode.CHUNK: RecordLayout(
        "Chunk",
        (
            ("message_start_time", Fields.u64),
            ("message_end_time", Fields.u64),
            ("uncompressed_size", Fields.u64),
            ("uncompressed_crc", Fields.u32),
            ("compression", Fields.text),
            ("records", Fields.long_bytes),
        ),
    ),
    Opcode.MESSAGE_INDEX: RecordLayout(
        "MessageIndex",
        (("channel_id", Fields.u16), ("records", Fields.time_offsets)),
    ),
    Opcode.CHUNK_INDEX: RecordLayout(
        "ChunkIndex",
        (
            ("message_start_time", Fields.u64),
            ("message_end_time", Fields.u64),
            ("chunk_start_offset", Fields.u64),
            ("chunk_length", Fields.u64),
            ("message_index_offsets", Fields.count_map),
            ("message_index_length", Fields.u64),
            ("compression", Fields.text),
            ("compressed_size", Fields.u64),
            ("uncompressed_size", Fields.u64),
        ),
    ),
    Opcode.ATTACHMENT: RecordLayout(
        "Attachment",
        (
            ("log_time", Fields.u64),
            ("create_time", Fields.u64),
            ("name", Fields.text),
            ("media_type", Fields.text),
            ("data", Fields.long_bytes),
            ("crc", Fields.u32),
        ),
    ),
    Opcode.ATTACHMENT_INDEX: RecordLayout(
        "AttachmentIndex",
        (
            ("offset", Fields.u64),
            ("length", Fields.u64),
            ("log_time", Fields.u64),
            ("create_time", Fields.u64),
            ("data_size", Fields.u64),
            ("name", Fields.text),
            ("media_type", Fields.text),
        ),
    ),
    Opcode.STATISTICS: RecordLayout(
        "Statistics",
        (
            ("message_count", Fields.u64),
            ("schema_count", Fields.u16),
            ("channel_count", Fields.u32),
            ("attachment_count", Fields.u32),
            ("metadata_count", Fields.u32),
            ("chunk_count", Fields.u32),
            ("message_start_time", Fields.u64),
            ("message_end_time", Fields.u64),
            ("channel_message_counts", Fields.count_map),
        ),
    ),
    Opcode.METADATA: RecordLayout("Metadata", (("name", Fields.text), ("metadata", Fields.text_map))),
    Opcode.METADATA_INDEX: RecordLayout(
        "MetadataIndex",
        (("offset", Fields.u64), ("length", Fields.u64), ("name", Fields.text)),
    ),
    Opcode.SUMMARY_OFFSET: RecordLayout(
        "SummaryOffset",
        (("group_opcode", Fields.u8), ("group_start", Fields.u64), ("group_length", Fields.u64)),
    ),
    Opcode.DATA_END: RecordLayout("DataEnd", (("data_section_crc", Fields.u32),)),
}


def record_name(opcode: int) -> str:
    """The record's name for messages to people."""
    return LAYOUTS[Opcode(opcode)].name if opcode in LAYOUTS else f"unknown (opcode 0x{opcode:02x})"


@dataclass(frozen=True, slots=True)
class RecordHeader:
    """Where a record lies: its first byte, and its content after opcode and length; all inside the file."""

    opcode: int
    offset: int
    length: int

    @property
    def content(self) -> int:
        """Offset of the first byte of the content."""
        return self.offset + RECORD_HEADER.size

    @property
    def end(self) -> int:
        """Offset of the first byte after the record."""
        return self.content + self.length


class RecordFile(AbstractContextManager["RecordFile"]):
    """A MCAP file, opened for reading wherever its records lie.

    Args:
        path: the file.
        shown_as: its name in messages, where `path` is an unpacked copy.

    Attributes:
        path: the file's name in messages.
        size: bytes at the time it was opened; what a recorder adds later is not seen.

    Raises:
        TraceFormatError: the file cannot be read, or does not begin as a MCAP file does.
    """

    def __init__(self, path: Path, shown_as: Path | None = None) -> None:
        self.path = shown_as or path
        try:
            self._descriptor = os.open(
                path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK
            )  # a pipe would wait for a writer
        except OSError as err:
            raise TraceFormatError(self.path, f"cannot be read ({err.strerror})") from err
        status = os.fstat(self._descriptor)
        self.size = status.st_size
        if not stat.S_ISREG(status.st_mode):
            self.close()
            raise TraceFormatError(self.path, "no MCAP file: it is no regular file")
        begin = self.read(0, min(len(MAGIC), self.size))
        if begin != MAGIC[: len(begin)]:
            self.close()
            raise TraceFormatError(self.path, "no MCAP file: it does not begin with MCAP's magic bytes", 0)

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the file descriptor back."""
        os.close(self._descriptor)

    def read(self, offset: int, size: int) -> bytes:
        """`size` bytes from `offset`, safe to call from several threads.

        Raises:
            TraceFormatError: the device fails, or the file has become shorter since it was opened.
        """
        data = bytearray(size)
        self.read_into(memoryview(data), offset)
        return bytes(data)

    def read_into(self, room: memoryview, offset: int) -> None:
        """Fill `room` with the bytes from `offset` on; threads and errors as for `read`."""
        done = 0
        try:
            while done < len(room):  # the kernel hands out at most 2 GiB at once
                count = os.preadv(self._descriptor, [room[done:]], offset + done)
                if not count:
                    raise TraceFormatError(self.path, "became shorter while it was read", offset + done)
                done += count
        except OSError as err:
            raise TraceFormatError(self.path, f"cannot be read ({err.strerror})", offset) from err

    def header_at(self, offset: int) -> RecordHeader:
        """The record that begins at `offset`.

        Raises:
            TornRecordError: there is none, or it is not there to its end.
        """
        if offset + RECORD_HEADER.size > self.size:
            raise TornRecordError(
                offset, "no footer" if offset >= self.size else "a record's header is cut off"
            )
        opcode, length = RECORD_HEADER.unpack(self.read(offset, RECORD_HEADER.size))
        if opcode == 0:
            raise TornRecordError(offset, "no record, but a zero byte")
        if length > self.size - offset - RECORD_HEADER.size:
            raise TornRecordError(offset, f"a {record_name(opcode)} record is cut off")
        return RecordHeader(opcode, offset, length)

    def parse(self, header: RecordHeader) -> dict[str, Any]:
        """The fields of a record.

        Raises:
            TornRecordError: they are not as MCAP has them, or too long to be meant.
        """
        name = record_name(header.opcode)
        if header.length > MAX_RECORD_BYTES:
            raise TornRecordError(header.offset, f"a {name} record claims {header.length} bytes")
        try:
            return LAYOUTS[Opcode(header.opcode)].parse(self.read(header.content, header.length))
        except ValueError as err:
            raise TornRecordError(header.offset, f"a {name} record is damaged ({err})") from err


class TornRecordError(Exception):
    """The records of a file end here, whether or not its bytes do."""

    def __init__(self, offset: int, why: str) -> None:
        super().__init__(f"byte {offset}: {why}")
        self.offset = offset
        self.why = why
