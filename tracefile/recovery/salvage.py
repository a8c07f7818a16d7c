"""The complete chunks of a cut off trace."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.threads import InlineExecutor

from ..format.encoding import MESSAGE_HEADER, RECORD_HEADER
from ..format.events import TOPIC_PREFIX, Records, Stage
from ..format.ring import SLOT_DTYPE, STAGE_NUMBERS, Slots
from ..mcapfile.file import TornRecordError
from ..mcapfile.records import Buffer, parse_record
from ..reading.mcap_source import MANY_RECORDS, McapSource
from ..reading.source import Text
from ..writing.event_chunks import LIBRARY
from ..writing.payloads import MOST_TOPICS, Payload, PayloadTopic

_NUMBER_OF_STAGE = {stage: number for number, stage in STAGE_NUMBERS.items()}


class Salvage(McapSource):
    """One-time source of the events (`SLOT_DTYPE` without tickets), texts and payloads of a file that a recorder left."""

    def __init__(self, path: Path) -> None:
        self._schemas: dict[int, Schema] = {}
        self._payload_topics: dict[int, PayloadTopic] = {}
        self._payloads: list[Payload] = []
        super().__init__(path, InlineExecutor())
        self.events = 0

    def items(self) -> Iterator[Slots | Text | Payload]:
        self._check_origin()
        for batch in self.batches():
            for stage, records in batch.events:
                self.events += len(records)
                yield _slots(stage, records)
            yield from batch.texts
            payloads, self._payloads = self._payloads, []
            yield from payloads
        suspicion = self.jobs.suspicion
        if self.steps_left < self.jobs.skipped_bytes // RECORD_HEADER.size:
            suspicion = MANY_RECORDS
        if suspicion:
            raise TraceFormatError(self._path, f"{suspicion}; not recovered")

    def _check_origin(self) -> None:
        try:
            library = self._file.parse(Header, self._file.header_at(self._start)).library
        except TornRecordError:  # a damaged header: the content decides
            return
        if not library.startswith(LIBRARY):
            raise TraceFormatError(
                self._path, f"was written by {library!r}, not by dds-trace; `mcap recover` closes such files"
            )

    def _declare(self, opcode: int, content: Buffer, offset: int) -> None:
        super()._declare(opcode, content, offset)
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, content)
            self._schemas[schema.id] = schema
            return
        channel = parse_record(Channel, content)
        declared = self._schemas.get(channel.schema_id)
        is_new = channel.id not in self._payload_topics and len(self._payload_topics) < MOST_TOPICS
        if is_new and declared is not None and not channel.topic.startswith(TOPIC_PREFIX):
            definition, encoding = declared.data.decode(errors="replace"), channel.message_encoding
            self._payload_topics[channel.id] = PayloadTopic(channel.topic, declared.name, definition, encoding)

    def _add_other(self, channel_id: int, log_time_ns: int, content: memoryview) -> None:
        if topic := self._payload_topics.get(channel_id):
            self._payloads.append(Payload(topic, bytes(content[MESSAGE_HEADER.size :]), log_time_ns))


def _slots(stage: Stage, records: Records) -> Slots:
    slots = np.zeros(len(records), SLOT_DTYPE)
    slots["event"], slots["stage"] = records.view(SLOT_DTYPE["event"]), _NUMBER_OF_STAGE[stage]
    return slots
