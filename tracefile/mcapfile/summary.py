"""What the end of a MCAP file says about the rest: claims, useful beforehand, and never a reason to trust a byte."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode

from ..format.crc import crc32
from ..format.event_record import RECORD_HEADER
from .event_scan import scan_records
from .records import LAYOUTS, MAGIC, RecordLayout

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .records import RecordFile

_FOOTER_LENGTH = 20
_MAX_BYTES = 32 << 20  # chunk indexes of half a million chunks
_KINDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX})
_FOOTER_BYTES = RECORD_HEADER.size + _FOOTER_LENGTH
_CRC_BYTES = 4


@dataclass(frozen=True, slots=True)
class Summary:
    """The records between the data and the footer.

    Attributes:
        data_end: where the data section must have ended.
        data: the summary's bytes.
        found: (opcode, byte offset of the content in `data`, its length) of each record.
    """

    data_end: int
    data: bytes = b""
    found: list[tuple[int, int, int]] = field(default_factory=list)

    def declarations(self) -> Iterator[tuple[int, memoryview, int]]:
        """Opcode, content, and offset in the file of each schema and channel."""
        for opcode, start, length in self.found:
            if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                yield opcode, memoryview(self.data)[start : start + length], self.data_end + start

    def parsed(self, opcode: Opcode) -> Iterator[dict[str, Any]]:
        """The fields of each record of one kind; those that are damaged are left out."""
        layout: RecordLayout = LAYOUTS[opcode]
        for kind, start, length in self.found:
            if kind == opcode:
                try:
                    yield layout.parse(memoryview(self.data)[start : start + length])
                except ValueError:
                    continue

    def message_counts(self) -> dict[int, int] | None:
        """Messages of each channel as the statistics have them; None without statistics."""
        for statistics in self.parsed(Opcode.STATISTICS):
            counts: dict[int, int] = statistics["channel_message_counts"]
            return counts
        return None

    def topics(self) -> list[str] | None:
        """The topics of all messages, by statistics and channels; None where these do not tell."""
        counts = self.message_counts()
        topics = {channel["id"]: channel["topic"] for channel in self.parsed(Opcode.CHANNEL)}
        if counts is None or not counts.keys() <= topics.keys():
            return None
        return list(topics.values())

    def chunk_channels(self) -> dict[int, frozenset[int]]:
        """The channels that each chunk has messages of, by the chunk's offset; chunks without index are left out."""
        return {
            index["chunk_start_offset"]: frozenset(index["message_index_offsets"])
            for index in self.parsed(Opcode.CHUNK_INDEX)
        }

    def chunk_offsets(self) -> list[int]:
        """Where the chunks begin, as the chunk index has it, in order."""
        offsets = {index["chunk_start_offset"] for index in self.parsed(Opcode.CHUNK_INDEX)}
        return sorted(offset for offset in offsets if offset < self.data_end)


def read_summary(file: RecordFile) -> Summary | None:
    """The summary of a file that ends as a finished file does, else None.

    A finished file without summary section, or with one that does not match its CRC, has an empty one.
    """
    footer_at = file.size - _FOOTER_BYTES - len(MAGIC)
    if footer_at < len(MAGIC):
        return None
    end = file.read(footer_at, _FOOTER_BYTES + len(MAGIC))
    if end[_FOOTER_BYTES:] != MAGIC or RECORD_HEADER.unpack_from(end) != (Opcode.FOOTER, _FOOTER_LENGTH):
        return None
    footer = LAYOUTS[Opcode.FOOTER].parse(end[RECORD_HEADER.size : _FOOTER_BYTES])
    start, crc = footer["summary_start"], footer["summary_crc"]
    if not len(MAGIC) <= start < footer_at or footer_at - start > _MAX_BYTES:
        return Summary(footer_at)
    data = file.read(start, footer_at - start)
    if crc and crc32(end[: _FOOTER_BYTES - _CRC_BYTES], crc32(data)) != crc:
        return Summary(footer_at)
    return Summary(start, data, scan_records(data, 0, len(data), _KINDS).others)
