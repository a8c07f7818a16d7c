"""What every recording is read as, and sources of messages in any storage: batches of events, and the few other messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import zstandard

from ..format.bag_metadata import RecordedTopic
from ..format.encoding import CDR_HEADER
from ..format.events import EVENT_CDR_BYTES, EVENT_DTYPE, Records, Stage
from ..mcapfile.chunks import unpack_zstd

LATEST_NS = 2**63 - 1
"""Latest time of a message that 64 bits with a sign hold (year 2262); MCAP has twice that."""

_UNSUSPECTED_MESSAGES, _LEAST_MESSAGE_BYTES = 2_000_000, 64
"""More messages than this, of fewer bytes each, are no recording but an attack."""


class UnreadableError(Exception):
    """The reading of a file ends here, in words that follow the file's name."""


class RawMessage(NamedTuple):
    """A serialized message; times in ns as recorded, None for one that the storage lacks."""

    topic: RecordedTopic
    log_ns: int
    publish_ns: int | None
    sequence: int | None
    data: bytes


@dataclass(slots=True)
class Condition:
    """What was found while a recording was read; complete after its last message."""

    damages: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    topics: set[RecordedTopic] = field(default_factory=set)
    claimed: dict[str, int] = field(default_factory=dict)
    chunks: list[tuple[int, int, int]] = field(default_factory=list)
    unreadable: Counter[str] = field(default_factory=Counter)


def full_type(name: str) -> str:
    """Return `std_msgs/msg/String` of `std_msgs/String`, as ROS 1 and early ROS 2 write it."""
    package, _, kind = name.partition("/")
    return f"{package}/msg/{kind}" if kind and "/" not in kind else name


class Budget:
    def __init__(self, size_bytes: int) -> None:
        self._messages = _UNSUSPECTED_MESSAGES + size_bytes // _LEAST_MESSAGE_BYTES

    def take(self) -> None:
        self._messages -= 1
        if self._messages < 0:
            raise UnreadableError("it has more messages than so few bytes hold")


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
