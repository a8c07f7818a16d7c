"""What every recording is read as, and sources of messages in any storage: batches of events, and the few other messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
import zstandard
from numpy.typing import NDArray

from ..format.bag_metadata import RecordedTopic
from ..format.encoding import CDR_HEADER
from ..format.events import EVENT_CDR_BYTES, EVENT_DTYPE, Records, Stage
from ..mcapfile.chunks import unpack_zstd
from ..mcapfile.records import Buffer

LATEST_NS = 2**63 - 1
"""Latest time of a message that 64 bits with a sign hold (year 2262); MCAP has twice that."""

NONE = -(2**63)
"""Value of a column for a message that lacks it."""

_UNSUSPECTED_MESSAGES, _LEAST_MESSAGE_BYTES = 2_000_000, 64
"""More messages than this, of fewer bytes each, are no recording but an attack."""


MOST_TOPICS = 10_000
"""A robot has some hundreds; each costs about a millisecond in an analysis."""


class UnreadableError(Exception):
    """The reading of a file ends here, in words that follow the file's name."""


class RawMessage(NamedTuple):
    """A serialized message; times in ns as recorded, None for one that the storage lacks."""

    topic: RecordedTopic
    log_ns: int
    publish_ns: int | None
    sequence: int | None
    data: bytes


Int64: TypeAlias = "NDArray[np.int64]"
Row = TypeVar("Row", bound=Sequence[Any])


@dataclass(frozen=True, slots=True, eq=False)
class MessageBatch:
    """Messages in stored order, as columns; `data` has their bytes from `starts` on, and is reused for the next batch.

    `topic` is the index in `topics`; `NONE` is a value that the storage lacks.
    """

    topics: Sequence[RecordedTopic]
    topic: Int64
    log_ns: Int64
    publish_ns: Int64
    sequence: Int64
    data: Buffer
    starts: Int64
    sizes: Int64

    def __len__(self) -> int:
        return len(self.topic)

    @classmethod
    def of(cls, messages: Sequence[RawMessage]) -> MessageBatch:
        """Make a batch of messages, at least one; of any storage but MCAP times have 63 bits."""
        recorded_topics, log_ns, publish_ns, sequences, contents = zip(*messages, strict=True)
        batch = cls.of_columns(
            {id(topic): topic for topic in recorded_topics}, [*map(id, recorded_topics)], log_ns, contents
        )
        return replace(batch, publish_ns=_column(publish_ns), sequence=_column(sequences))

    @classmethod
    def of_columns(
        cls,
        topics: Mapping[int, RecordedTopic],
        topic_ids: Sequence[int],
        log_ns: Sequence[int],
        contents: Sequence[bytes],
    ) -> MessageBatch:
        index_of = {key: index for index, key in enumerate(dict.fromkeys(topic_ids))}
        sizes, none = np.array([*map(len, contents)], np.int64), np.full(len(contents), NONE)
        return cls(
            [topics[key] for key in index_of],
            np.array([*map(index_of.__getitem__, topic_ids)], np.int64),
            np.maximum(np.array(log_ns, np.int64), -LATEST_NS),
            none,
            none,
            b"".join(contents),
            np.cumsum(sizes) - sizes,
            sizes,
        )

    def selected(self, rows: NDArray[np.bool_]) -> MessageBatch:
        names = ("topic", "log_ns", "publish_ns", "sequence", "starts", "sizes")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def content(self, index: int) -> bytes:
        start = int(self.starts[index])
        return bytes(self.data[start : start + int(self.sizes[index])])

    def messages(self) -> Iterator[RawMessage]:
        columns = (self.topic, self.log_ns, self.publish_ns, self.sequence, self.starts, self.sizes)
        for topic, log_ns, publish_ns, sequence, start, size in zip(*(c.tolist() for c in columns), strict=True):
            yield RawMessage(
                self.topics[topic],
                log_ns,
                None if publish_ns == NONE else publish_ns,
                None if sequence == NONE else sequence,
                bytes(self.data[start : start + size]),
            )


def _column(values: Sequence[int | None]) -> Int64:
    if values.count(None) == len(values):
        return np.full(len(values), NONE)
    return np.array([NONE if value is None else value for value in values], np.int64)


_BATCH_MESSAGES, _BATCH_BYTES = 2048, 4 << 20


def batched(messages: Iterable[RawMessage]) -> Iterator[MessageBatch]:
    return map(MessageBatch.of, in_parts(messages))


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

    def take(self, count: int = 1) -> int:
        """Return how many of the next messages are read; an error if none is."""
        if count > self._messages:
            count = self._messages
            if not count:
                raise UnreadableError("it has more messages than so few bytes hold")
        self._messages -= count
        return count


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
