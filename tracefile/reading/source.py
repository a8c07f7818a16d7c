"""Sources of messages in any storage: batches of events, and the few other messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import zstandard

from ..format.encoding import CDR_HEADER
from ..format.events import EVENT_CDR_BYTES, EVENT_DTYPE, Records, Stage
from ..mcapfile.chunks import unpack_zstd

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
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
    """Consecutive messages of a trace.

    Attributes:
        events: (stage, contiguous array of `EVENT_DTYPE`) pairs; each stage's events are in file order.
        truncated: why the source ends early, in its last batch; else None.
    """

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
    """Unpack a message that rosbag2 has compressed by itself; return any other, or a damaged one, unchanged.

    Serialized CDR begins with a zero byte, so it is never taken for a zstd frame.
    """
    if data[:4] != _ZSTD_MAGIC:
        return data
    try:
        return unpack_zstd(data, most_bytes)
    except (zstandard.ZstdError, MemoryError):
        return data
