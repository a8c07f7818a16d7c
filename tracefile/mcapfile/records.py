"""Records of MCAP parsed into the classes of the `mcap` library, with bounds that it does not have."""

from __future__ import annotations

from io import BytesIO
from typing import Protocol, TypeAlias, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Statistics

from dds_trace.base.units import counted

try:  # reading lz4 spends a fifth of its time in this checksum; isal's is four times as fast
    from isal.isal_zlib import crc32
except ImportError:  # a device that only records, or a platform without a wheel of it
    from zlib import crc32

__all__ = ["ParsedRecord", "RecordContent", "crc32", "parse_record", "record_name"]


Buffer: TypeAlias = bytes | memoryview


_MAX_MAP_RECORD_BYTES = 2 << 20
"""Longest record with a map: each of the 65,536 possible channels fits."""

_HAS_MAP = frozenset({Channel, Statistics})


class ParsedRecord(Protocol):
    @staticmethod
    def read(stream: ReadDataStream) -> object: ...


R = TypeVar("R", bound=ParsedRecord)


class RecordContent(ReadDataStream):
    """The content of one record, field by field; bytes after the last field are ignored, as MCAP demands."""

    def __init__(self, content: Buffer) -> None:
        super().__init__(BytesIO())
        self._content = memoryview(content)
        self._at = 0

    @property
    def count(self) -> int:
        return self._at

    def read(self, length: int) -> bytes:
        end = self._at + length
        if end > len(self._content):
            raise ValueError(f"a field of {counted(length, 'byte')} reaches beyond its record")
        field = bytes(self._content[self._at : end])
        self._at = end
        return field


def parse_record(kind: type[R], content: Buffer) -> R:
    if kind in _HAS_MAP and len(content) > _MAX_MAP_RECORD_BYTES:
        raise ValueError(f"it has {counted(len(content), 'byte')}, more than any file needs")
    record = kind.read(RecordContent(content))
    assert isinstance(record, kind)
    return record


def record_name(opcode: int) -> str:
    try:
        return Opcode(opcode).name.title().replace("_", "")
    except ValueError:
        return f"unknown (opcode 0x{opcode:02x})"
