"""Schemas and channels of the files that we write, and how any record is encoded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema

from ..format.events import EVENT_DEFINITION, EVENT_SCHEMA_NAME, RUN_TOPIC, SESSION_TOPIC, Stage
from ..format.string_cdr import STRING_DEFINITION, STRING_SCHEMA_NAME

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mcap.records import McapRecord

LIBRARY = "dds-trace"
"""Beginning of the library field of our files' Header."""

EVENT_SCHEMA = Schema(id=1, name=EVENT_SCHEMA_NAME, encoding="ros2msg", data=EVENT_DEFINITION.encode())
STRING_SCHEMA = Schema(id=2, name=STRING_SCHEMA_NAME, encoding="ros2msg", data=STRING_DEFINITION.encode())
TYPE_HASHES = {
    EVENT_SCHEMA_NAME: "RIHS01_bda991ead4fe8ce479c129efc17c1affed4da47fbc0d1731d7bad959cf922db2",
    STRING_SCHEMA_NAME: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
}
"""Message type -> type description hash of ROS 2 (REP 2016), computed once by rosbags from the definitions."""

EVENT_TOPICS = tuple(stage.topic for stage in Stage)
"""Topics of channels 1 to 4; a channel's id is the stage's number in the ring."""

TEXT_TOPICS = (SESSION_TOPIC, RUN_TOPIC)
"""Topics of channels 5 and 6; further texts get channels as they come."""


def declarations_of(channels: Sequence[Channel]) -> bytes:
    """Return the schema and channel records at the beginning of a chunk.

    Every chunk has its own, so that a damaged chunk loses no messages but its own.
    """
    schemas = {channel.schema_id: schema_of(channel) for channel in channels}
    return b"".join(map(encode_record, [*schemas.values(), *channels]))


def encode_record(record: McapRecord) -> bytes:
    """Return a record with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves it open
    return data


def schema_of(channel: Channel) -> Schema:
    """Return the schema of one of our channels."""
    return EVENT_SCHEMA if channel.schema_id == EVENT_SCHEMA.id else STRING_SCHEMA
