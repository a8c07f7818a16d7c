"""Messages of other programs on their way into a trace."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from mcap.records import Message

from .event_chunks import Chunk, Index, encode_record

MOST_WAITING_BYTES = 60 << 20
"""Most bytes that wait for the disk; what comes meanwhile is left out. One message with them fits a readable chunk (64 MiB)."""
CHUNK_BYTES = 4 << 20
MOST_TOPICS = 10_000


@dataclass(frozen=True, slots=True)
class PayloadTopic:
    """A topic of others; `definition` is the text of its type in ros2msg, empty if unknown, as is `encoding` of no CDR."""

    topic: str
    type_name: str
    definition: str = ""
    encoding: str = "cdr"


@dataclass(frozen=True, slots=True)
class Payload:
    """A serialized message, and its arrival in ns since 1970."""

    topic: PayloadTopic
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
