"""The topics of MCAP channels that can have events."""

from __future__ import annotations

from collections.abc import ItemsView
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from dds_trace.base.errors import TraceFormatError

from ..format.events import STAGE_OF_TOPIC, TOPIC_PREFIX, Stage
from .records import Buffer, parse_record, record_name

_MOST_CACHED_BYTES = 4096  # of a record that is parsed once: ours have some hundred


@dataclass(frozen=True, slots=True)
class DeclaredChannel:
    topic: str
    stage: Stage | None
    fault: str | None


class ChannelTable:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, DeclaredChannel] = {}

    def get(self, channel_id: int) -> DeclaredChannel | None:
        return self._channels.get(channel_id)

    def items(self) -> ItemsView[int, DeclaredChannel]:
        return self._channels.items()

    def declare(self, opcode: int, content: Buffer, offset: int) -> None:
        """Add a Schema or Channel record at `offset` in the file."""
        try:
            is_long = len(content) > _MOST_CACHED_BYTES
            record = _parse(opcode, content) if is_long else _parsed_once(opcode, bytes(content))
        except ValueError as err:
            name = record_name(opcode)
            raise TraceFormatError(self._path, f"a {name} record is damaged ({err})", offset) from err
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
        else:
            self._add(record, offset)

    def _add(self, channel: Channel, offset: int) -> None:
        declared = self._channels.get(channel.id)
        if declared is not None and declared.topic != channel.topic:
            if not declared.topic.startswith(TOPIC_PREFIX) and not channel.topic.startswith(TOPIC_PREFIX):
                return  # of others, and beyond the 65,536 ids of a file: nothing of them is read
            raise TraceFormatError(
                self._path,
                f"channel {channel.id} is {declared.topic!r} and here {channel.topic!r}; "
                "its messages cannot be distinguished",
                offset,
            )
        stage = STAGE_OF_TOPIC.get(channel.topic)
        fault = self._fault(channel, stage.schema_name) if stage else None
        self._channels[channel.id] = DeclaredChannel(channel.topic, stage, fault)

    def _fault(self, channel: Channel, expected: str) -> str | None:
        if channel.message_encoding != "cdr":
            return f"its messages are encoded as {channel.message_encoding!r}, not 'cdr'"
        schema = self._schemas.get(channel.schema_id, expected)  # a lost schema is not another schema
        if schema != expected:
            return f"its schema is {schema!r}, not {expected!r}"
        return None


def _parse(opcode: int, content: Buffer) -> Schema | Channel:
    return parse_record(Schema, content) if opcode == Opcode.SCHEMA else parse_record(Channel, content)


_parsed_once = lru_cache(maxsize=256)(_parse)
