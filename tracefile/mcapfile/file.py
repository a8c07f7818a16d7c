"""A MCAP file as bytes: reads at any offset from any thread, and headers of records whose lengths are not trusted."""

from __future__ import annotations

import os
import stat
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import read_into
from dds_trace.base.units import counted

from ..format.framing import MAGIC, RECORD_HEADER
from .records import parse_record, record_name

if TYPE_CHECKING:
    from collections.abc import Container
    from pathlib import Path

    from .records import ParsedRecord

    R = TypeVar("R", bound=ParsedRecord)

_AHEAD_BYTES = 4096  # many small records at once; beside a chunk it costs no more than a record's header

MAX_RECORD_BYTES = 64 << 20
"""Longest record, packed or unpacked, that is held in memory as a whole; writers' chunks have 0.7 to 8 MB."""


class TornRecordError(Exception):
    """The end of what can be read of a file, whether or not its bytes end there."""

    def __init__(self, offset: int, why: str) -> None:
        super().__init__(f"byte {offset}: {why}")
        self.offset = offset
        self.why = why


@dataclass(frozen=True, slots=True)
class RecordHeader:
    """Opcode and place of a record that lies in its file as a whole.

    Attributes:
        opcode: the kind of record, known to MCAP or not.
        offset: offset of the record's first byte in the file.
        length: bytes of its content.
    """

    opcode: int
    offset: int
    length: int

    @property
    def content(self) -> int:
        """Offset of the first byte of the content, which follows opcode and length."""
        return self.offset + RECORD_HEADER.size

    @property
    def end(self) -> int:
        """Offset of the first byte behind the record."""
        return self.content + self.length


class RecordFile(AbstractContextManager["RecordFile"]):
    """A MCAP file, opened for reading at any offset.

    Args:
        path: the file.
        shown_as: its name in messages, where `path` is an unpacked copy.

    Attributes:
        path: the file's name in messages.
        size: bytes when it was opened; what a recorder adds later is not read.

    Raises:
        TraceFormatError: the file cannot be read, or does not begin as a MCAP file does.
    """

    def __init__(self, path: Path, shown_as: Path | None = None) -> None:
        self.path = shown_as or path
        self._ahead, self._ahead_at = b"", 0
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
            raise TraceFormatError(self.path, "no MCAP file: it is not a regular file")
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
        """Return `size` bytes from `offset` on.

        Raises:
            TraceFormatError: the device fails, or the file has become shorter since it was opened.
        """
        data = bytearray(size)
        self.read_into(memoryview(data), offset)
        return bytes(data)

    def read_into(self, room: memoryview, offset: int) -> None:
        """Fill `room` with the bytes from `offset` on.

        Raises:
            TraceFormatError: as for `read`.
        """
        try:
            done = read_into(self._descriptor, room, offset)
        except OSError as err:
            raise TraceFormatError(self.path, f"cannot be read ({err.strerror})", offset) from err
        if done < len(room):
            raise TraceFormatError(self.path, "became shorter while it was read", offset + done)

    def peek(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from `offset` on, read ahead for the next call; only for the one thread that walks headers.

        Raises:
            TraceFormatError: as for `read`.
        """
        at = offset - self._ahead_at
        if at < 0 or at + size > len(self._ahead):
            self._ahead = self.read(offset, max(size, min(_AHEAD_BYTES, self.size - offset)))
            self._ahead_at, at = offset, 0
        return self._ahead[at : at + size]

    def header_at(self, offset: int, wanted: Container[int] | None = None) -> RecordHeader:
        """Return the header of the record that begins at `offset`, or of the first behind it of a wanted kind.

        Args:
            offset: offset of a record.
            wanted: opcodes of the records that are not stepped over; None for all.

        Raises:
            TornRecordError: no record begins there, or the file ends before the record does.
        """
        while True:
            if offset + RECORD_HEADER.size > self.size:
                raise TornRecordError(
                    offset, "no footer" if offset >= self.size else "a record's header is cut off"
                )
            at = offset - self._ahead_at
            if at < 0 or at + RECORD_HEADER.size > len(self._ahead):
                self.peek(offset, RECORD_HEADER.size)
                at = 0
            opcode, length = RECORD_HEADER.unpack_from(self._ahead, at)
            if opcode == 0:
                raise TornRecordError(offset, "no record, but a zero byte")
            if length > self.size - offset - RECORD_HEADER.size:
                raise TornRecordError(offset, f"a {record_name(opcode)} record is cut off")
            if wanted is None or opcode in wanted:
                return RecordHeader(opcode, offset, length)
            offset += RECORD_HEADER.size + length

    def parse(self, kind: type[R], header: RecordHeader) -> R:
        """Read and parse a record of the class `kind`.

        Raises:
            TornRecordError: its fields are not as MCAP has them, or it is longer than `MAX_RECORD_BYTES`.
        """
        name = record_name(header.opcode)
        if header.length > MAX_RECORD_BYTES:
            raise TornRecordError(header.offset, f"a {name} record claims {counted(header.length, 'byte')}")
        try:
            return parse_record(kind, self.read(header.content, header.length))
        except ValueError as err:
            raise TornRecordError(header.offset, f"a {name} record is damaged ({err})") from err
