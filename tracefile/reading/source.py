"""What every source of messages hands to the reader: batches of events as arrays, and the few other messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
import zstandard

from ..format.events import EVENT_CDR_BYTES, EVENT_DTYPE
from ..format.string_cdr import CDR_HEADER
from ..mcapfile.chunks import unpack_zstd

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from ..format.event_record import Records
    from ..format.events import Stage

TOPIC_PREFIX = "/dds_trace/"

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MESSAGE_BYTES = 16 << 20


@dataclass(frozen=True, slots=True)
class Text:
    """One message that is not an event: a description or a host sample, still serialized.

    Attributes:
        log_time_ns: wall clock, ns since 1970.
        data: the message as it was recorded.
        path: the file it came from.
        offset: the byte of the file that it, or the chunk around it, begins at; None in a database.
    """

    topic: str
    log_time_ns: int
    data: bytes
    path: Path
    offset: int | None


@dataclass(slots=True)
class Batch:
    """Some consecutive messages of a trace.

    Attributes:
        events: the events of each stage, an unbroken array of `EVENT_DTYPE`, in file order.
        texts: the messages of our other topics, in file order.
        unreadable: messages on event topics that are not events.
        notes: what a reader of the numbers should be told, one line each.
        truncated: why the source ends early, in its last batch.
    """

    events: list[tuple[Stage, Records]] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)
    unreadable: int = 0
    notes: list[str] = field(default_factory=list)
    truncated: str | None = None


class Source(Protocol):
    """One file of messages."""

    @property
    def topics(self) -> frozenset[str]:
        """All topics seen so far, ours or not."""

    @property
    def written_events(self) -> int:
        """Events that our recorder had put into the file, by their numbers; those in damaged chunks count too."""

    def expected_events(self) -> Mapping[Stage, int]:
        """How many events the file says it holds; a claim, never to be relied on."""

    def batches(self) -> Iterator[Batch]:
        """All messages in file order."""

    def close(self) -> None:
        """Give the file back."""


def event_batch(messages: Sequence[tuple[Stage, bytes]]) -> Batch:
    """A batch of single messages of event topics; those that are no events are counted as unreadable."""
    events: dict[Stage, list[bytes]] = {}
    unreadable = 0
    for stage, data in messages:
        if len(data) == EVENT_CDR_BYTES and data[:2] == CDR_HEADER[:2]:
            events.setdefault(stage, []).append(data)
        else:
            unreadable += 1
    dtype = np.dtype([("cdr", f"V{len(CDR_HEADER)}"), ("event", EVENT_DTYPE)])
    arrays = [(stage, np.frombuffer(b"".join(held), dtype)["event"].copy()) for stage, held in events.items()]
    return Batch(arrays, unreadable=unreadable)


def plain(data: bytes) -> bytes:
    """The message, unpacked where rosbag2 has compressed it on its own; unchanged where that fails.

    Serialized CDR begins with a zero byte, so a zstd frame cannot be taken for it.
    """
    if data[:4] != ZSTD_MAGIC:
        return data
    try:
        return unpack_zstd(data, _MESSAGE_BYTES)
    except (zstandard.ZstdError, MemoryError):
        return data
