"""What every kind of recording is read as."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

LATEST_NS = 2**63 - 1
"""Latest time of a message that 64 bits with a sign hold (year 2262); MCAP has twice that."""

_UNSUSPECTED_MESSAGES, _MESSAGE_BYTES = 2_000_000, 64
"""More messages than this, of fewer bytes each, are no recording but an attack."""


class UnreadableError(Exception):
    """The reading of a file ends here, in words that follow the file's name."""


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic as the recording declares it; a text is empty where there is none."""

    name: str
    message_type: str
    encoding: str
    definition: str = ""
    definition_encoding: str = ""
    qos: str = ""
    publisher: str = ""
    type_hash: str = ""


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
        self._messages = _UNSUSPECTED_MESSAGES + size_bytes // _MESSAGE_BYTES

    def take(self) -> None:
        self._messages -= 1
        if self._messages < 0:
            raise UnreadableError("it has more messages than so few bytes hold")
