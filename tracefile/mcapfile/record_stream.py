"""Every record of a MCAP file, one by one, chunks opened: for looking into a file, and for judging the walker."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode

from ..errors import TraceFormatError
from ..format.event_record import EVENT_RECORD_BYTES, RECORD_HEADER
from ..units.counts import counted
from .event_scan import Scan, scan_records
from .packed_chunks import DamagedChunkError, PackedChunk
from .records import LAYOUTS, MAGIC, RecordFile, TornRecordError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from .records import Buffer


def read_records(path: Path) -> Iterator[tuple[Opcode, dict[str, Any]]]:
    """Each record's kind and its fields, in file order; in place of a chunk the records in it.

    Records of kinds that MCAP does not define are passed over, as it asks.

    Raises:
        TraceFormatError: at the first byte that does not follow the MCAP specification.
    """
    with RecordFile(path) as file:
        at = len(MAGIC)
        opcode = 0
        while opcode != Opcode.FOOTER:
            try:
                header = file.header_at(at)
                opcode = header.opcode
                if opcode == Opcode.CHUNK:
                    chunk = PackedChunk.at(file, header)
                    yield from _records_in(chunk.unpack(file))
                elif opcode in LAYOUTS:
                    yield Opcode(opcode), file.parse(header)
            except TornRecordError as err:
                raise TraceFormatError(path, err.why, err.offset) from err
            except (DamagedChunkError, ValueError) as err:
                raise TraceFormatError(path, f"the chunk is damaged: {err}", at) from err
            at = header.end
        if file.read(at, file.size - at) != MAGIC:
            raise TraceFormatError(path, "the closing magic bytes are not there, or not the last", at)


def _records_in(data: Buffer) -> Iterator[tuple[Opcode, dict[str, Any]]]:
    scan = scan_records(data, 0, len(data), LAYOUTS)
    if scan.end != len(data):
        raise DamagedChunkError(
            counted(len(data) - scan.end, "byte in it is no record", "bytes in it are no records")
        )
    for opcode, start, length in sorted([*_events(scan), *scan.others], key=lambda found: found[1]):
        yield Opcode(opcode), LAYOUTS[Opcode(opcode)].parse(memoryview(data)[start : start + length])


def _events(scan: Scan) -> Iterator[tuple[int, int, int]]:
    """The events of a scan as if they had been found one by one."""
    length = EVENT_RECORD_BYTES - RECORD_HEADER.size
    for offset, count in scan.runs:
        for number in range(count):
            yield Opcode.MESSAGE, offset + number * EVENT_RECORD_BYTES + RECORD_HEADER.size, length
