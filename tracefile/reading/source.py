"""Sources of messages in any storage: batches of events, and the few other messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import zstandard

from ..format.encoding import CDR_HEADER
from ..format.events import EVENT_CDR_BYTES, EVENT_DTYPE, Records, Stage
from ..mcapfile.chunks import unpack_zstd


class UnreadableError(Exception):
    """The reading of a file ends here, in words that follow the file's name."""


_UNSUSPECTED_MESSAGES, _LEAST_MESSAGE_BYTES = 2_000_000, 64
"""More messages than this, of fewer bytes each, are no recording but an attack."""


class Budget:
    def __init__(self, size_bytes: int) -> None:
        self._messages = _UNSUSPECTED_MESSAGES + size_bytes // _LEAST_MESSAGE_BYTES

    def take(self, count: int = 1) -> int:
        """Return how many of the next messages are read; an error if none is."""
        if count > self._messages:
            count = self._messages
            if not count:
                raise UnreadableError("it has more messages than so few bytes hold")
        self._messages -= count
        return count


Row = TypeVar("Row", bound=Sequence[Any])

_BATCH_MESSAGES, _BATCH_BYTES = 2048, 4 << 20


def in_parts(rows: Iterable[Row], data_at: int = -1) -> Iterator[list[Row]]:
    """Collect rows that have content at an index; an error comes after all rows before it."""
    pending, size_bytes = list[Row](), 0
    try:
        for row in rows:
            pending.append(row)
            if isinstance(data := row[data_at], bytes):
                size_bytes += len(data)
            if len(pending) == _BATCH_MESSAGES or size_bytes >= _BATCH_BYTES:
                yield pending
                pending, size_bytes = [], 0
    except Exception:
        if pending:
            yield pending
        raise
    if pending:
        yield pending


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MESSAGE_BYTES = 16 << 20  # no message of ours is longer; more is not unpacked


@dataclass(frozen=True, slots=True)
class Text:
    """Message that is not an event: a description or a host sample, still serialized."""

    topic: str
    log_time_ns: int
    data: bytes
    path: Path
    offset: int | None


@dataclass(slots=True)
class Batch:
    """Consecutive messages; `events` are arrays of `EVENT_DTYPE` in file order, `truncated` why the source ends early."""

    events: list[tuple[Stage, Records]] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)
    unreadable: int = 0
    notes: list[str] = field(default_factory=list)
    truncated: str | None = None


class Source(Protocol):
    @property
    def topics(self) -> frozenset[str]:
        """Topics seen so far, ours or not."""

    @property
    def written_events(self) -> int:
        """Events that our recorder had written to the file, those in damaged chunks included."""

    def expected_events(self) -> Mapping[Stage, int]:
        """Return each stage's events as the file claims; it may be wrong."""

    def batches(self) -> Iterator[Batch]: ...

    def close(self) -> None: ...


def event_batch(singles: Sequence[tuple[Stage, bytes]]) -> Batch:
    events: dict[Stage, list[bytes]] = {}
    unreadable = 0
    for stage, data in singles:
        if len(data) == EVENT_CDR_BYTES and data[:2] == CDR_HEADER[:2]:
            events.setdefault(stage, []).append(data)
        else:
            unreadable += 1
    dtype = np.dtype([("cdr", f"V{len(CDR_HEADER)}"), ("event", EVENT_DTYPE)])
    arrays = [(stage, np.frombuffer(b"".join(messages), dtype)["event"].copy()) for stage, messages in events.items()]
    return Batch(arrays, unreadable=unreadable)


def unpack_message(data: bytes, most_bytes: int = _MESSAGE_BYTES) -> bytes:
    """Unpack a message that rosbag2 compressed by itself; any other (CDR begins with zero), or a damaged one, stays."""
    if data[:4] != ZSTD_MAGIC:
        return data
    try:
        return unpack_zstd(data, most_bytes)
    except (zstandard.ZstdError, MemoryError):
        return data
