"""Content of MCAP chunks: slots of the ring in, records and their index out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TypeAlias

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, McapRecord, Message, Schema
from numpy.typing import NDArray

from ..format.bag_metadata import RecordedTopic
from ..format.encoding import STRING_DEFINITION, STRING_SCHEMA_NAME
from ..format.events import (
    EVENT_DEFINITION,
    EVENT_DTYPE,
    EVENT_RECORD_BYTES,
    EVENT_RECORD_DTYPE,
    EVENT_SCHEMA_NAME,
    RUN_TOPIC,
    SESSION_TOPIC,
    TAP_DEFINITION,
    TAP_SCHEMA_NAME,
    EventColumns,
    Stage,
    fill_constants,
)
from ..format.ring import SLOT_DTYPE, STAGE_NUMBERS, Slots

LIBRARY = "dds-trace"

EVENT_SCHEMA = Schema(id=1, name=EVENT_SCHEMA_NAME, encoding="ros2msg", data=EVENT_DEFINITION.encode())
STRING_SCHEMA = Schema(id=2, name=STRING_SCHEMA_NAME, encoding="ros2msg", data=STRING_DEFINITION.encode())
TAP_SCHEMA = Schema(id=3, name=TAP_SCHEMA_NAME, encoding="ros2msg", data=TAP_DEFINITION.encode())
SCHEMAS = {schema.id: schema for schema in (EVENT_SCHEMA, STRING_SCHEMA, TAP_SCHEMA)}
TYPE_HASHES = {
    EVENT_SCHEMA_NAME: "RIHS01_bda991ead4fe8ce479c129efc17c1affed4da47fbc0d1731d7bad959cf922db2",
    TAP_SCHEMA_NAME: "RIHS01_ea4932f85dd1427298e22e6d0a55466588a304d69baae5cfc0cc74aed409139f",
    STRING_SCHEMA_NAME: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
}
"""Type description hashes of ROS 2 (REP 2016), computed by rosbags from the definitions."""

EVENT_TOPICS = tuple(stage.topic for stage in Stage)
"""Topics of channels 1 to 5; a channel's id is the stage's number in the ring."""

TEXT_TOPICS = (SESSION_TOPIC, RUN_TOPIC)
"""Topics of channels 6 and 7; further topics get the next ids."""


def declarations_of(channels: Sequence[Channel], known: Mapping[int, Schema]) -> bytes:
    """Return the schema and channel records at the start of a chunk, so that a damaged one loses only itself."""
    schemas = {channel.schema_id: known[channel.schema_id] for channel in channels}
    return b"".join(map(encode_record, [*schemas.values(), *channels]))


def encode_record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves it open
    return data


MESSAGES_AT = 4096
"""Offset of the messages in the builder's buffer, after schemas and channels."""

Positions: TypeAlias = "NDArray[np.intp]"

Index: TypeAlias = "NDArray[np.uint64]"
"""uint64 array of shape (messages, 2): log time, offset in the chunk; the body of a MessageIndex record."""


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Uncompressed chunk, its earliest and latest log time (ns since 1970), and channel id -> index of its messages."""

    content: memoryview
    start_ns: int
    end_ns: int
    index: Mapping[int, Index]


def positions_by_channel(slots: Slots) -> dict[int, Positions]:
    stages = slots["stage"].copy()
    by_channel = {number: np.flatnonzero(stages == number) for number in range(1, len(Stage) + 1)}
    return {number: positions for number, positions in by_channel.items() if len(positions)}


def slots_in_time(events: Mapping[Stage, EventColumns]) -> Slots:
    numbered = [(number, events[stage]) for number, stage in STAGE_NUMBERS.items() if stage in events]
    slots = np.zeros(sum(len(columns) for _, columns in numbered), SLOT_DTYPE)
    end = 0
    for number, columns in numbered:
        records = np.empty(len(columns), EVENT_DTYPE)
        for name in EVENT_DTYPE.names or ():
            records[name] = getattr(columns, name)
        start, end = end, end + len(records)
        slots["event"][start:end] = records.view(slots["event"].dtype)
        slots["stage"][start:end] = number
    return slots[np.argsort(slots["monotonic_ns"], kind="stable")]


class EventChunkBuilder:
    """Builds in one reused buffer: fresh memory is slow at its first touch."""

    def __init__(self, wall_offset_ns: int, max_events: int) -> None:
        self._wall_offset_ns = wall_offset_ns
        self._buffer = np.zeros(MESSAGES_AT + max_events * EVENT_RECORD_BYTES, np.uint8)
        self._messages = np.frombuffer(self._buffer, EVENT_RECORD_DTYPE, max_events, MESSAGES_AT)
        fill_constants(self._messages)

    def build(
        self,
        slots: Slots,
        by_channel: Mapping[int, Positions],
        declarations: bytes,
        written: Mapping[int, int],
        not_before_ns: int,
    ) -> Chunk:
        """Build the chunk of one to `max_events` slots in their order; its content is lost at the next call.

        Threads may stamp in one order and get their slots in another, microseconds apart. The file has the order of the
        slots; a log time that would run backwards repeats the previous one (`monotonic_ns` is untouched).

        Args:
            slots: the events.
            by_channel: their positions, from `positions_by_channel`.
            declarations: at most `MESSAGES_AT` bytes.
            written: channel id -> messages that the file already has.
            not_before_ns: log time of the file's last message.
        """
        count = len(slots)
        messages = self._messages[:count]
        times = slots["monotonic_ns"] + self._wall_offset_ns
        times[0] = max(int(times[0]), not_before_ns)
        np.maximum.accumulate(times, out=times)
        messages["event"] = slots["event"]
        messages["times_ns"] = times[:, None]
        messages["channel_id"] = slots["stage"]
        index: dict[int, Index] = {}
        for channel_id, positions in by_channel.items():
            first = written.get(channel_id, 0)
            messages["number"][positions] = np.arange(first, first + len(positions))
            entries = np.empty((len(positions), 2), np.uint64)
            entries[:, 0] = times[positions]
            entries[:, 1] = positions * EVENT_RECORD_BYTES + len(declarations)
            index[channel_id] = entries
        start = MESSAGES_AT - len(declarations)
        self._buffer[start:MESSAGES_AT] = np.frombuffer(declarations, np.uint8)
        end = MESSAGES_AT + count * EVENT_RECORD_BYTES
        return Chunk(self._buffer.data[start:end], int(times[0]), int(times[-1]), index)


MOST_WAITING_BYTES = 60 << 20
"""Most bytes that wait for the disk; what comes meanwhile is left out. One message with them fits a readable chunk (64 MiB)."""
CHUNK_BYTES = 4 << 20


@dataclass(frozen=True, slots=True)
class Payload:
    """A serialized message, and its arrival in ns since 1970."""

    topic: RecordedTopic
    data: bytes | bytearray
    log_time_ns: int


class PayloadQueue:
    """One thread puts, another takes."""

    def __init__(self) -> None:
        self.left_out = 0
        self._payloads: deque[Payload] = deque()
        self._put_bytes = self._taken_bytes = 0  # each changed by one thread

    @property
    def waiting_bytes(self) -> int:
        return self._put_bytes - self._taken_bytes

    def put(self, payload: Payload) -> None:
        if self.waiting_bytes + len(payload.data) > MOST_WAITING_BYTES:
            self.left_out += 1
            return
        self._put_bytes += len(payload.data)
        self._payloads.append(payload)

    def first(self) -> list[Payload]:
        batch, size_bytes = list[Payload](), 0
        for payload in islice(self._payloads, len(self._payloads)):
            size_bytes += len(payload.data)
            if batch and size_bytes > CHUNK_BYTES:
                break
            batch.append(payload)
        return batch

    def remove(self, batch: Sequence[Payload]) -> None:
        for payload in batch:
            self._payloads.popleft()
            self._taken_bytes += len(payload.data)


def payload_chunk(declarations: bytes, batch: Sequence[tuple[int, Payload]], written: Mapping[int, int]) -> Chunk:
    content, entries = bytearray(declarations), dict[int, list[tuple[int, int]]]()
    for channel_id, payload in batch:
        rows_so_far = entries.setdefault(channel_id, [])
        rows_so_far.append((payload.log_time_ns, len(content)))
        number = (written.get(channel_id, 0) + len(rows_so_far) - 1) % (1 << 32)
        content += encode_record(
            Message(channel_id, payload.log_time_ns, bytes(payload.data), payload.log_time_ns, number)
        )
    times = [payload.log_time_ns for _, payload in batch]
    index: dict[int, Index] = {entry: np.array(sorted(rows), np.uint64) for entry, rows in entries.items()}
    return Chunk(memoryview(content), min(times), max(times), index)
