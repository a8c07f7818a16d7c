"""What a ping sends: a `DataType` of the trace makes a `Payload`, a series of serialized messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from recorder.backend import Serialization
    from recorder.stamp import StampPlace

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


@dataclass(frozen=True, slots=True)
class Payload:
    """The messages of a run, sent in turn and from the start again.

    Attributes:
        payload_bytes: of the messages; of the largest, if they differ.
    """

    data_type: DataType
    messages: Sequence[Message]
    payload_bytes: int


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
