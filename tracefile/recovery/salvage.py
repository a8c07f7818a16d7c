"""The complete chunks of a cut off trace, in file order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema

from dds_trace.base.errors import TraceFormatError

from ..format.encoding import MESSAGE_HEADER, RECORD_HEADER, decode_string
from ..format.events import EVENT_RECORD_BYTES, EVENT_RECORD_DTYPE, TOPIC_PREFIX
from ..format.ring import SLOT_DTYPE, STAGE_NUMBERS, Slots
from ..mcapfile.blocks import most_unpacked_bytes
from ..mcapfile.channels import ChannelTable
from ..mcapfile.chunks import DamagedChunkError, PackedChunk
from ..mcapfile.file import RecordFile, RecordHeader, TornRecordError
from ..mcapfile.records import parse_record
from ..mcapfile.scan import scan_records
from ..writing.event_chunks import LIBRARY
from ..writing.payloads import MOST_TOPICS, Payload, PayloadTopic

_NUMBER_OF_STAGE = {stage: number for number, stage in STAGE_NUMBERS.items()}
_CHANNEL_IDS = 1 << 16  # a channel id has 16 bits

_UNSUSPECTED_STEPS = 1_000_000
_STEP_BYTES = 32  # a second at 10 Hz needs a kilobyte: a chunk and six records
_CHUNK_STEPS, _RECORD_STEPS = 16, 2


@dataclass(frozen=True, slots=True)
class SalvagedText:
    topic: str
    text: str
    log_time_ns: int


class Salvage:
    """One-time iterable of the events (`SLOT_DTYPE` without tickets), texts and payloads in the complete chunks of a file."""

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self._channels = ChannelTable(file.path)
        self._stages = np.zeros(_CHANNEL_IDS, np.uint8)  # channel id -> number of its stage, or 0
        self._schemas: dict[int, Schema] = {}
        self._payload_topics: dict[int, PayloadTopic] = {}
        self._next_number: dict[int, int] = {}
        self._steps_left = _UNSUSPECTED_STEPS + file.size // _STEP_BYTES
        self._unpacked_bytes = 0
        self.closed = False
        self.events = 0
        self.torn_bytes = 0
        self.damaged_chunks = 0

    @property
    def tickets(self) -> int:
        return sum(self._next_number.values())  # MCAP sequences count the messages of a channel

    def __iter__(self) -> Iterator[Slots | SalvagedText | Payload]:
        at = self._file.data_start
        while not self.closed:
            try:
                header = self._file.header_at(at)
            except TornRecordError:
                self.torn_bytes = max(self._file.size - at, 0)
                break
            self._take_steps(_RECORD_STEPS)
            if header.opcode == Opcode.HEADER:
                self._check_origin(header)
            elif header.opcode == Opcode.CHUNK:
                yield from self._chunk(header)
            self.closed = header.opcode == Opcode.FOOTER
            at = header.end

    def _check_origin(self, header: RecordHeader) -> None:
        try:
            library = self._file.parse(Header, header).library
        except TornRecordError:  # a damaged header: the content decides
            return
        if not library.startswith(LIBRARY):
            raise TraceFormatError(
                self._file.path, f"was written by {library!r}, not by dds-trace; `mcap recover` closes such files"
            )

    def _chunk(self, header: RecordHeader) -> Iterator[Slots | SalvagedText | Payload]:
        self._take_steps(_CHUNK_STEPS)
        try:
            chunk = PackedChunk.at(self._file, header)
            self._unpacked_bytes += chunk.unpacked_bytes
            if self._unpacked_bytes > most_unpacked_bytes(header.end):
                raise self._suspected("it unpacks to far more than a recorder packs into so few bytes")
            data = chunk.unpack(self._file)
        except DamagedChunkError:
            self.damaged_chunks += 1
            return
        scan = scan_records(data, 0, len(data))
        self._take_steps(scan.steps + len(scan.others))
        single = {content: (opcode, length) for opcode, content, length in scan.others}
        runs = dict(scan.runs)
        for at in sorted([*single, *runs]):
            if at in runs:
                records = np.frombuffer(data, EVENT_RECORD_DTYPE, runs[at], at)
                yield self._slots(records)
                others = np.flatnonzero(self._stages[records["channel_id"]] == 0).tolist()  # as long as an event
                self._take_steps(len(others))
                for number in others:
                    start, end = (at + step * EVENT_RECORD_BYTES for step in (number, number + 1))
                    yield from self._text(memoryview(data)[start + RECORD_HEADER.size : end])
                continue
            opcode, length = single[at]
            content = memoryview(data)[at : at + length]
            if opcode == Opcode.MESSAGE:
                yield from self._text(content)
            else:
                self._channels.declare(opcode, content, header.offset)
                if opcode == Opcode.SCHEMA:
                    schema = parse_record(Schema, content)
                    self._schemas[schema.id] = schema
                if opcode == Opcode.CHANNEL:
                    self._add_payload_topic(parse_record(Channel, content))
                    channel_id = int.from_bytes(content[:2], "little")
                    channel = self._channels.get(channel_id)
                    if channel is not None and channel.stage:
                        self._stages[channel_id] = _NUMBER_OF_STAGE[channel.stage]

    def _take_steps(self, steps: int) -> None:
        self._steps_left -= steps
        if self._steps_left < 0:
            raise self._suspected("it has more small records than a recorder writes into so few bytes")

    def _suspected(self, why: str) -> TraceFormatError:
        return TraceFormatError(self._file.path, f"{why}; not recovered")

    def _slots(self, messages: np.ndarray[tuple[int], np.dtype[np.void]]) -> Slots:
        slots = np.zeros(len(messages), SLOT_DTYPE)
        slots["event"] = messages["event"]
        slots["stage"] = self._stages[messages["channel_id"]]
        messages, slots = messages[slots["stage"] > 0], slots[slots["stage"] > 0]
        for number in np.unique(slots["stage"]):
            highest = int(messages["number"][slots["stage"] == number].max())
            self._next_number[int(number)] = max(self._next_number.get(int(number), 0), highest + 1)
        self.events += len(slots)
        return slots

    def _add_payload_topic(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        is_new = channel.id not in self._payload_topics and len(self._payload_topics) < MOST_TOPICS
        if is_new and schema is not None and not channel.topic.startswith(TOPIC_PREFIX):
            definition, encoding = schema.data.decode(errors="replace"), channel.message_encoding
            self._payload_topics[channel.id] = PayloadTopic(channel.topic, schema.name, definition, encoding)

    def _text(self, content: memoryview) -> Iterator[SalvagedText | Payload]:
        channel_id, _, log_time_ns, _ = MESSAGE_HEADER.unpack_from(content)
        if topic := self._payload_topics.get(channel_id):
            yield Payload(topic, bytes(content[MESSAGE_HEADER.size :]), log_time_ns)
            return
        channel = self._channels.get(channel_id)
        if channel is None:
            return
        try:
            text = decode_string(content[MESSAGE_HEADER.size :])
        except ValueError:  # not a String of the recorder's
            return
        yield SalvagedText(channel.topic, text, log_time_ns)
