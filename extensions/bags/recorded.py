"""What every recording is read as, and what was found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dds_trace.tracefile.format.bag_metadata import RecordedTopic
from dds_trace.tracefile.mcapfile.records import Buffer
from dds_trace.tracefile.reading.source import in_parts

LATEST_NS = np.iinfo(np.int64).max
"""Latest time of a message that 64 bits with a sign hold (year 2262); MCAP has twice that."""

NONE = np.iinfo(np.int64).min
"""Value of a column for a message that lacks it."""


class RawMessage(NamedTuple):
    """A serialized message; times in ns as recorded, None for one that the storage lacks."""

    topic: RecordedTopic
    log_ns: int
    publish_ns: int | None
    sequence: int | None
    data: bytes


Int64: TypeAlias = "NDArray[np.int64]"


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


def batched(messages: Iterable[RawMessage]) -> Iterator[MessageBatch]:
    return map(MessageBatch.of, in_parts(messages))


@dataclass(slots=True)
class Condition:
    """What was found while a recording was read; complete after its last message.

    The remainder of a damaged recording lacks the messages in `gone`, by topic, that this one counted.
    """

    damages: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    topics: set[RecordedTopic] = field(default_factory=set)
    claimed: dict[str, int] = field(default_factory=dict)
    chunks: list[tuple[int, int, int]] = field(default_factory=list)
    unreadable: Counter[str] = field(default_factory=Counter)
    is_remainder: bool = False
    gone: Counter[str] = field(default_factory=Counter)


def full_type(name: str) -> str:
    """Return `std_msgs/msg/String` of `std_msgs/String`, as ROS 1 and early ROS 2 write it."""
    package, _, kind = name.partition("/")
    return f"{package}/msg/{kind}" if kind and "/" not in kind else name
