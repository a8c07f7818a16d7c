"""The schemas and channels that a MCAP file declares, and the channels among them that can have events."""

from __future__ import annotations

from collections.abc import ItemsView
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from dds_trace.base.errors import TraceFormatError

from ..format.events import STAGE_OF_TOPIC, TOPIC_PREFIX, Stage, event_fault
from .records import Buffer, parse_record, record_name

_MOST_CACHED_BYTES = 4096  # of a record that is parsed once: ours have some hundred


@dataclass(frozen=True, slots=True)
class DeclaredChannel:
    record: Channel
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

    def declare(self, opcode: int, content: Buffer, offset: int) -> str:
        """Add a Schema or Channel record at `offset` in the file; return what is wrong with it."""
        try:
            is_long = len(content) > _MOST_CACHED_BYTES
            record = _parse(opcode, content) if is_long else _parsed_once(opcode, bytes(content))
        except ValueError as err:
            fault = f"a {record_name(opcode)} record is damaged ({err})"
            if self._is_trace:
                raise TraceFormatError(self._path, fault, offset) from err
            return fault
        if isinstance(record, Schema):
            if record.id not in self._settled[0]:
                self.schemas[record.id] = record
        elif record.id not in self._settled[1]:
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
        self._channels[channel.id] = DeclaredChannel(channel, stage, fault)


def _parse(opcode: int, content: Buffer) -> Schema | Channel:
    return parse_record(Schema, content) if opcode == Opcode.SCHEMA else parse_record(Channel, content)


_parsed_once = lru_cache(maxsize=256)(_parse)
