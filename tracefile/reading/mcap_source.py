"""Messages of one MCAP file as batches, made on all cores."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

from mcap.opcode import Opcode

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.units import counted

from ..format.descriptions import Session
from ..format.encoding import MESSAGE_HEADER, decode_string
from ..format.events import TOPIC_PREFIX, Stage
from ..mcapfile.blocks import Block
from ..mcapfile.file import RecordFile
from ..mcapfile.scan import MESSAGES_AND_CHANNELS
from .mcap_walk import McapWalk
from .source import Batch, Text, UnreadableError, event_batch, unpack_message

_UNSUSPECTED_STEPS = 2_000_000
_STEP_BYTES = 4  # a recorded message that is not an event needs more, even packed
_SMALL_FILE_BYTES = 1 << 19  # read by the calling thread, before another has started

MANY_RECORDS = "it has more small records than a recorder writes into so few bytes"


class McapSource:
    """MCAP file as a `Source`; `pool` unpacks and checks chunks, `shown_as` is the name of an unpacked copy in errors."""

    def __init__(self, path: Path, pool: Executor, shown_as: Path | None = None) -> None:
        self._path = shown_as or path
        self._file = RecordFile(path, shown_as)
        try:
            self.walk = McapWalk(self._file, is_trace=True)
        except TraceFormatError:
            self.close()
            raise
        if self._file.size > _SMALL_FILE_BYTES:
            self.walk.pool = pool
        self._channels = self.walk.channels
        self._messages = Counter[int]()  # channel id -> number of its messages
        self.steps_left = 0
        self.refusal = ""
        self._numbered: dict[int, int] = {}  # channel id -> 1 + number of its last event

    def close(self) -> None:
        self._file.close()

    @property
    def topics(self) -> frozenset[str]:
        return frozenset(channel.topic for _, channel in self._channels.items())

    @property
    def written_events(self) -> int:
        return sum(self._numbered.values())

    def expected_events(self) -> dict[Stage, int]:
        counts = self.walk.claimed
        most = self._file.size  # a claim of more than one event per packed byte is not believed
        if counts is None:
            return {}
        expected = Counter[Stage]()
        for channel_id, channel in self._channels.items():
            if channel.stage:
                expected[channel.stage] += counts.get(channel_id, 0)
        return {stage: min(most, count) for stage, count in expected.items()}

    def batches(self) -> Iterator[Batch]:
        """Yield all messages in file order; the last batch describes how the file ended."""
        are_declared = self.walk.claimed is not None and all(map(self._channels.get, self.walk.claimed))
        if are_declared and self.topics and not any(topic.startswith(TOPIC_PREFIX) for topic in self.topics):
            return  # a recording of others
        self.steps_left = _UNSUSPECTED_STEPS + self._file.size // _STEP_BYTES
        truncated = None
        try:
            for block in self.walk:
                yield from self._batches_of(block)
                self.steps_left -= block.steps
                if self.steps_left < 0:
                    truncated = f"is read up to byte {block.offset(len(block.data))}: {MANY_RECORDS}"
                    break
        except UnreadableError as err:
            if not self._messages and not self.topics:
                raise TraceFormatError(self._path, str(err), 0) from err
            self.refusal = str(err)
            truncated = f"ends early, {err}"
        if self.walk.torn:
            truncated = f"ends early, {self.walk.torn}; everything complete before it is used"
        yield Batch(notes=self._closing_notes(), truncated=truncated)

    def _batches_of(self, block: Block) -> Iterator[Batch]:
        batch = Batch()
        singles: list[tuple[int, int]] = []
        for opcode, start, length in block.scan.others:
            if opcode == Opcode.MESSAGE:
                singles.append((start, length))
            elif opcode in MESSAGES_AND_CHANNELS:
                self.walk.declare(opcode, memoryview(block.data)[start : start + length], block.offset(start))
        for channel_id, last_number, events in block.events:
            channel = self._channels.get(channel_id)
            if channel and not channel.stage:
                # Texts and payloads as long as an event.
                singles += block.scan.contents(block.data, channel_id)
                continue
            self._messages[channel_id] += len(events)
            if channel and channel.fault:
                batch.unreadable += len(events)
            elif channel and channel.stage:
                batch.events.append((channel.stage, events))
                self._numbered[channel_id] = last_number + 1
        packed: list[tuple[Stage, bytes]] = []
        for start, length in sorted(singles):
            content = memoryview(block.data)[start : start + length]
            self._add_single(content, block.offset(start), batch, packed)
        yield batch
        if packed:
            yield event_batch(packed)

    def _add_single(self, content: memoryview, offset: int, batch: Batch, packed: list[tuple[Stage, bytes]]) -> None:
        if len(content) < MESSAGE_HEADER.size:
            return
        channel_id, _, log_time_ns, _ = MESSAGE_HEADER.unpack_from(content)
        self._messages[channel_id] += 1
        channel = self._channels.get(channel_id)
        if channel is None or not channel.topic.startswith(TOPIC_PREFIX):
            self._add_other(channel_id, log_time_ns, content)
            return
        data = bytes(content[MESSAGE_HEADER.size :])
        if channel.fault:
            batch.unreadable += 1
        elif channel.stage:
            packed.append((channel.stage, unpack_message(data)))
        else:
            batch.texts.append(Text(channel.topic, log_time_ns, unpack_message(data), self._path, offset))

    def _add_other(self, channel_id: int, log_time_ns: int, content: memoryview) -> None: ...

    def _closing_notes(self) -> list[str]:
        notes = [*self.walk.damages, *self.walk.notes]
        for channel_id, count in sorted(self._messages.items()):
            channel = self._channels.get(channel_id)
            if channel is None:
                notes.append(
                    f"{counted(count, 'message belongs', 'messages belong')} to channel {channel_id}, "
                    "which is never declared; not used"
                )
            elif channel.fault:
                notes.append(
                    f"{counted(count, 'message')} of {channel.topic} {'is' if count == 1 else 'are'} not used: {channel.fault}"
                )
        for channel_id, claimed in (self.walk.claimed or {}).items():
            channel = self._channels.get(channel_id)
            if channel and channel.stage and claimed != self._messages[channel_id]:
                count = self._messages[channel_id]
                notes.append(
                    f"the statistics claim {counted(claimed, 'message')} of {channel.topic}, "
                    f"{count:,} {'was' if count == 1 else 'were'} found"
                )
        return notes


def read_first_session(path: Path) -> Session | None:
    try:
        with RecordFile(path) as file:
            for block in McapWalk(file, is_trace=True):
                for opcode, start, length in block.scan.others:
                    if opcode == Opcode.MESSAGE and block.chunks:
                        text = decode_string(memoryview(block.data)[start + MESSAGE_HEADER.size : start + length])
                        return Session.from_json(text, path)
    except (TraceFormatError, UnreadableError, ValueError):
        pass
    return None
