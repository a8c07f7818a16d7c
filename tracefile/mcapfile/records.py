"""Records of MCAP parsed into the classes of the `mcap` library, with bounds that it does not have."""

from __future__ import annotations

from collections.abc import ItemsView, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Protocol, TypeAlias, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted

from ..format.bag_metadata import RecordedTopic
from ..format.events import STAGE_OF_TOPIC, TOPIC_PREFIX, Stage, event_fault

try:  # reading lz4 spends a fifth of its time in this checksum; isal's is four times as fast
    from isal.isal_zlib import crc32
except ImportError:  # a device that only records, or a platform without a wheel of it
    from zlib import crc32

__all__ = [
    "ChannelTable",
    "DeclaredChannel",
    "ParsedRecord",
    "RecordContent",
    "crc32",
    "parse_record",
    "record_name",
    "topic_of",
]


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


_MOST_CACHED_BYTES = 4096  # of a record that is parsed once: ours have some hundred


@dataclass(frozen=True, slots=True)
class DeclaredChannel:
    record: Channel
    schema: Schema | None
    stage: Stage | None
    fault: str | None

    @property
    def topic(self) -> str:
        return self.record.topic


class ChannelTable:
    """Declarations by id. Of a trace of ours a damaged one is an error; elsewhere the last one of an id counts."""

    def __init__(self, path: Path, *, is_trace: bool = True) -> None:
        self._path, self._is_trace = path, is_trace
        self._settled: tuple[frozenset[int], frozenset[int]] = frozenset(), frozenset()
        self.schemas: dict[int, Schema] = {}
        self._channels: dict[int, DeclaredChannel] = {}
        self.changes = 0

    def get(self, channel_id: int) -> DeclaredChannel | None:
        return self._channels.get(channel_id)

    def items(self) -> ItemsView[int, DeclaredChannel]:
        return self._channels.items()

    def settle(self) -> None:
        """Let no later declaration replace one so far, if this is no trace of ours."""
        if not self._is_trace:
            self._settled = frozenset(self.schemas), frozenset(self._channels)

    def add_missing(self, other: ChannelTable) -> None:
        self.schemas = {**other.schemas, **self.schemas}
        self._channels = {**other._channels, **self._channels}
        self.changes += 1

    def would_change(self, opcode: int, content: Buffer) -> bool:
        """Return whether a Schema or Channel record differs from what is declared so far."""
        with suppress(ValueError):
            return not self._is_declared(_record(opcode, content))
        return False

    def _is_declared(self, record: Schema | Channel) -> bool:
        if isinstance(record, Schema):
            return record.id in self._settled[0] or self.schemas.get(record.id) == record
        declared = self._channels.get(record.id)
        if record.id in self._settled[1] or declared is None:
            return declared is not None
        return declared.record == record and declared.schema is self.schemas.get(record.schema_id)

    def declare(self, opcode: int, content: Buffer, offset: int) -> str:
        """Add a Schema or Channel record at `offset` in the file; return what is wrong with it."""
        try:
            record = _record(opcode, content)
        except ValueError as err:
            fault = f"a {record_name(opcode)} record is damaged ({err})"
            if self._is_trace:
                raise TraceFormatError(self._path, fault, offset) from err
            return fault
        if not self._is_declared(record):
            self.changes += 1
            if isinstance(record, Schema):
                self.schemas[record.id] = record
            else:
                self._add(record, offset)
        return ""

    def _add(self, channel: Channel, offset: int) -> None:
        declared = self._channels.get(channel.id)
        if self._is_trace and declared is not None and declared.topic != channel.topic:
            if not declared.topic.startswith(TOPIC_PREFIX) and not channel.topic.startswith(TOPIC_PREFIX):
                return  # of others, and beyond the 65,536 ids of a file: nothing of them is read
            raise TraceFormatError(
                self._path,
                f"channel {channel.id} is {declared.topic!r} and here {channel.topic!r}; "
                "its messages cannot be distinguished",
                offset,
            )
        stage = STAGE_OF_TOPIC.get(channel.topic)
        schema = self.schemas.get(channel.schema_id)  # a lost schema is not another schema
        fault = event_fault(stage, channel.message_encoding, schema.name if schema else None) if stage else None
        self._channels[channel.id] = DeclaredChannel(channel, schema, stage, fault)


def _record(opcode: int, content: Buffer) -> Schema | Channel:
    return _parse(opcode, content) if len(content) > _MOST_CACHED_BYTES else _parsed_once(opcode, bytes(content))


def _parse(opcode: int, content: Buffer) -> Schema | Channel:
    return parse_record(Schema, content) if opcode == Opcode.SCHEMA else parse_record(Channel, content)


_parsed_once = lru_cache(maxsize=256)(_parse)


TEXT_ENCODINGS = frozenset({"ros1msg", "ros2msg", "ros2idl", "omgidl", "jsonschema"})


def topic_of(channel: Channel, schemas: Mapping[int, Schema]) -> RecordedTopic:
    schema = schemas.get(channel.schema_id)
    is_text = schema is not None and schema.encoding in TEXT_ENCODINGS
    return RecordedTopic(
        channel.topic,
        schema.name if schema else "",
        channel.message_encoding,
        schema.data.decode(errors="replace") if schema and is_text else "",
        schema.encoding if schema else "",
        channel.metadata.get("offered_qos_profiles", ""),
        channel.metadata.get("callerid", ""),
        channel.metadata.get("topic_type_hash", ""),
        schema.data if schema and schema.encoding == "protobuf" else b"",
    )
