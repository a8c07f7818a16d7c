"""What a ping sends: a `DataType` of the trace makes a `Payload`, a series of serialized messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Sequence

    from ..backends.base import Serialization
    from .stamp import StampPlace

RELAY_SUFFIX = "_relay"
"""Of a topic's name for the way back."""


@dataclass(frozen=True, slots=True)
class Message:
    """One serialized message with room for the stamp.

    Attributes:
        data: the whole buffer, encapsulation included; the ping patches the stamp in place.
        payload_bytes: application bytes of it, the stamp not counted.
    """

    data: bytearray
    payload_bytes: int


class Feed(Protocol):
    """A live source of messages, whose arrivals are the schedule."""

    def begin(self) -> None:
        """Keep what arrives from now on."""

    def take(self, stop: threading.Event) -> tuple[Message, int] | None:
        """The next message and when it arrived (monotonic ns); waits for it, None if `stop` is set."""

    @property
    def skipped(self) -> int:
        """Messages that arrived while too many waited already, and were not kept."""


@dataclass(frozen=True, slots=True)
class Payload:
    """The messages of a run, sent in turn and from the start again.

    Attributes:
        payload_bytes: of the messages; of the largest, if they differ.
        rate_hz: at which the data was recorded, None if it has no rate of its own.
        source: where the data is from, as `--data` named it; empty for random data.
        feed: gives the messages of the run as they arrive from a live source; `messages` are for probes then.
    """

    data_type: DataType
    messages: Sequence[Message]
    payload_bytes: int
    rate_hz: float | None = None
    source: str = ""
    feed: Feed | None = None


@dataclass(frozen=True, slots=True)
class DataType:
    """One kind of data: its names, where its messages keep the stamp, and how a payload is made.

    Attributes:
        name: as in the trace, `binary`, `string`, `imu`.
        topic: of the way out; the way back has `RELAY_SUFFIX`.
        type_name: ROS name of the message type.
        stamps: where the stamp is, for each serialization.
        make: the payload for a size in bytes (None: the type's default) and a seed of its random content.
        payload_bytes_of: application bytes of a received message, for each serialization.
    """

    name: str
    topic: str
    type_name: str
    stamps: dict[Serialization, StampPlace]
    make: Callable[[int | None, int], Payload]
    payload_bytes_of: dict[Serialization, Callable[[Any], int]]

    @property
    def relay_topic(self) -> str:
        """The topic of the way back."""
        return self.topic + RELAY_SUFFIX
