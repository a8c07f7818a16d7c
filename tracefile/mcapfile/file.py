"""A MCAP file as bytes, read from any thread; no length is trusted."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from mcap.opcode import Opcode
from mcap.records import Footer, Statistics

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import read_into
from dds_trace.base.units import counted

from ..format.encoding import MAGIC, RECORD_HEADER
from .records import ParsedRecord, crc32, parse_record, record_name
from .scan import scan_records

R = TypeVar("R", bound=ParsedRecord)


_AHEAD_BYTES = 4096  # many small records at once

MAX_RECORD_BYTES = 64 << 20
"""Longest record, packed or unpacked, that is read whole; chunks have 0.7 to 8 MB."""


class TornRecordError(Exception):
    """The end of what can be read of a file, whether or not its bytes end there."""

    def __init__(self, offset: int, why: str) -> None:
        super().__init__(f"byte {offset}: {why}")
        self.offset = offset
        self.why = why


@dataclass(frozen=True, slots=True)
class RecordHeader:
    opcode: int
    offset: int
    length: int

    @property
    def content(self) -> int:
        return self.offset + RECORD_HEADER.size

    @property
    def end(self) -> int:
        return self.content + self.length


class Records:
    def __init__(self, data: bytes) -> None:
        self._data, self.size = data, len(data)

    def read(self, offset: int, size: int) -> bytes:
        return self._data[offset : offset + size]

    def peek(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from `offset` on, perhaps reading ahead; only for the thread that walks headers."""
        return self.read(offset, size)

    def header_at(self, offset: int) -> RecordHeader:
        if offset + RECORD_HEADER.size > self.size:
            raise TornRecordError(offset, "no footer" if offset >= self.size else "a record's header is cut off")
        opcode, length = RECORD_HEADER.unpack(self.peek(offset, RECORD_HEADER.size))
        if opcode == 0:
            raise TornRecordError(offset, "no record, but a zero byte")
        if length > self.size - offset - RECORD_HEADER.size:
            raise TornRecordError(offset, f"a {record_name(opcode)} record is cut off")
        return RecordHeader(opcode, offset, length)


class RecordFile(Records, AbstractContextManager["RecordFile"]):
    def __init__(self, path: Path, shown_as: Path | None = None) -> None:
        self.path = shown_as or path
        self._ahead, self._ahead_at = b"", 0
        try:
            # Without blocking: a pipe would wait for a writer.
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except OSError as err:
            raise TraceFormatError(self.path, f"cannot be read ({err.strerror})") from err
        status = os.fstat(self._descriptor)
        self.size = status.st_size
        if not stat.S_ISREG(status.st_mode):
            self.close()
            raise TraceFormatError(self.path, "not a MCAP file: it is not a regular file")

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def close(self) -> None:
        os.close(self._descriptor)

    def read(self, offset: int, size: int) -> bytes:
        data = bytearray(size)
        self.read_into(memoryview(data), offset)
        return bytes(data)

    def read_into(self, target: memoryview, offset: int) -> None:
        try:
            count = read_into(self._descriptor, target, offset)
        except OSError as err:
            raise TraceFormatError(self.path, f"cannot be read ({err.strerror})", offset) from err
        if count < len(target):
            raise TraceFormatError(self.path, "became shorter while it was read", offset + count)

    def peek(self, offset: int, size: int) -> bytes:
        at = offset - self._ahead_at
        if at < 0 or at + size > len(self._ahead):
            self._ahead = self.read(offset, max(size, min(_AHEAD_BYTES, self.size - offset)))
            self._ahead_at, at = offset, 0
        return self._ahead[at : at + size]

    def parse(self, kind: type[R], header: RecordHeader) -> R:
        name = record_name(header.opcode)
        if header.length > MAX_RECORD_BYTES:
            raise TornRecordError(header.offset, f"a {name} record claims {counted(header.length, 'byte')}")
        try:
            return parse_record(kind, self.read(header.content, header.length))
        except ValueError as err:
            raise TornRecordError(header.offset, f"a {name} record is damaged ({err})") from err


_FOOTER_LENGTH = 20
_FOOTER_BYTES = RECORD_HEADER.size + _FOOTER_LENGTH
_CRC_BYTES = 4
_MAX_BYTES = 32 << 20  # chunk indexes of half a million chunks
_KINDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS})


@dataclass(frozen=True, slots=True)
class Summary:
    """The records between data section and footer: useful, but not trusted."""

    data_end: int
    data: bytes = b""
    is_checked: bool = False
    records: list[tuple[int, int, int]] = field(default_factory=list)

    def declarations(self) -> Iterator[tuple[int, memoryview, int]]:
        for opcode, start, length in self.records:
            if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                yield opcode, memoryview(self.data)[start : start + length], self.data_end + start

    def message_counts(self) -> dict[int, int] | None:
        for opcode, start, length in self.records:
            if opcode == Opcode.STATISTICS:
                with suppress(ValueError):
                    content = memoryview(self.data)[start : start + length]
                    return parse_record(Statistics, content).channel_message_counts
        return None


def read_summary(file: RecordFile) -> Summary | None:
    footer_at = file.size - _FOOTER_BYTES - len(MAGIC)
    if footer_at < len(MAGIC):
        return None
    end = file.read(footer_at, _FOOTER_BYTES + len(MAGIC))
    if end[_FOOTER_BYTES:] != MAGIC or RECORD_HEADER.unpack_from(end) != (Opcode.FOOTER, _FOOTER_LENGTH):
        return None
    footer = parse_record(Footer, end[RECORD_HEADER.size : _FOOTER_BYTES])
    start = footer.summary_start
    if not len(MAGIC) <= start < footer_at or footer_at - start > _MAX_BYTES:
        return Summary(footer_at)
    data = file.read(start, footer_at - start)
    if footer.summary_crc and crc32(end[: _FOOTER_BYTES - _CRC_BYTES], crc32(data)) != footer.summary_crc:
        return Summary(footer_at)
    return Summary(start, data, footer.summary_crc > 0, scan_records(data, 0, len(data), _KINDS).others)
