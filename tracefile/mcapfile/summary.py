"""The summary at the end of a MCAP file: claims about the rest, useful beforehand, and no reason to trust a byte."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer, Statistics

from ..format.framing import MAGIC, RECORD_HEADER, crc32
from .records import OPCODES, parse_record
from .scan import scan_records

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .file import RecordFile
    from .records import ParsedRecord

    R = TypeVar("R", bound=ParsedRecord)

_FOOTER_LENGTH = 20
_FOOTER_BYTES = RECORD_HEADER.size + _FOOTER_LENGTH
_CRC_BYTES = 4
_MAX_BYTES = 32 << 20  # chunk indexes of half a million chunks
_KINDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX})


@dataclass(frozen=True, slots=True)
class Summary:
    """The records between the data section and the footer.

    Attributes:
        data_end: offset in the file at which the data section ends and `data` begins.
        data: the summary's bytes.
        records: (opcode, byte offset of the content in `data`, its length) of each record.
    """

    data_end: int
    data: bytes = b""
    records: list[tuple[int, int, int]] = field(default_factory=list)

    def declarations(self) -> Iterator[tuple[int, memoryview, int]]:
        """Yield opcode, content and offset in the file of each schema and channel."""
        for opcode, start, length in self.records:
            if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                yield opcode, memoryview(self.data)[start : start + length], self.data_end + start

    def parsed(self, kind: type[R]) -> Iterator[R]:
        """Yield each record of the class `kind`, without those that are damaged."""
        for opcode, start, length in self.records:
            if opcode == OPCODES[kind]:
                try:
                    yield parse_record(kind, memoryview(self.data)[start : start + length])
                except ValueError:
                    continue

    def message_counts(self) -> dict[int, int] | None:
        """Return channel id -> number of messages as the statistics have it; None without statistics."""
        statistics = next(self.parsed(Statistics), None)
        return None if statistics is None else statistics.channel_message_counts

    def chunk_offsets(self) -> list[int]:
        """Return the offsets of the chunks that have an index, in order."""
        offsets = {index.chunk_start_offset for index in self.parsed(ChunkIndex)}
        return sorted(offset for offset in offsets if offset < self.data_end)


def read_summary(file: RecordFile) -> Summary | None:
    """Read the summary.

    Returns:
        None if the file does not end as a finished file does. A finished file without summary section, or with one
        that does not match its CRC, has an empty summary.

    Raises:
        TraceFormatError: the file cannot be read.
    """
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
    return Summary(start, data, scan_records(data, 0, len(data), _KINDS).others)
