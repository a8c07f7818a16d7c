"""Data that a ping sends: a `DataType` makes it up, a `Source` reads it; both give a `Payload` of serialized messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import MAX_PAYLOAD_BYTES

from ..errors import StoppedError
from .stamp import SentT

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from ..backends.node import Node, RawMessage, RosMessage
    from .stamp import HeaderStampPlace, StampPlace, StringStampPlace

ReceivedT = TypeVar("ReceivedT")

RELAY_SUFFIX = "_relay"
"""End of a topic's name on the way back."""


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
        """Keep the messages that arrive from now on."""

    def take(self, stop: threading.Event) -> tuple[Message, int] | None:
        """Wait for the next message; return it and its arrival (monotonic ns), or None if `stop` is set."""

    @property
    def skipped(self) -> int:
        """Messages that arrived while too many waited already, and were not kept."""


@dataclass(frozen=True, slots=True)
class Payload:
    """The messages of a run, sent in turn and from the start again.

    Attributes:
        payload_bytes: application bytes of a message; of the largest, if they differ.
        rate_hz: rate at which the data was recorded, None if it has no rate of its own.
        source: origin of the data as `--data` named it; empty for random data.
        feed: the messages of the run as they arrive from a live source; `messages` are for probes then.
    """

    data_type: DataType
    messages: Sequence[Message]
    payload_bytes: int
    rate_hz: float | None = None
    source: str = ""
    feed: Feed | None = None


@dataclass(frozen=True, slots=True)
class Form(Generic[SentT, ReceivedT]):
    """One form of a data type's messages: serialized, or as message objects.

    Attributes:
        stamp: place of the stamp in a message.
        payload_bytes_of: returns the application bytes of a received message.
        sizing_bytes_of: returns how many of the first bytes of a message decide, together with its length, what
            `payload_bytes_of` returns; None for message objects.
    """

    stamp: StampPlace[SentT, ReceivedT]
    payload_bytes_of: Callable[[ReceivedT], int]
    sizing_bytes_of: Callable[[RawMessage], int] | None = None


def sized_by_length(_message: RawMessage) -> int:
    """Return 0, `Form.sizing_bytes_of` of a type whose payload follows from the message's length and that of its first string."""
    return 0


class Maker(Protocol):
    """Function that makes up a payload."""

    def __call__(self, size_bytes: int | None, seed: int, stop: threading.Event | None = None, /) -> Payload:
        """Make up a payload.

        Args:
            size_bytes: application bytes of a message; None for the type's default.
            seed: seed of its random content.
            stop: ends the work once it is set.

        Raises:
            OptionError: there is no payload of that size.
            StoppedError: `stop` was set.
        """


@dataclass(frozen=True, slots=True)
class DataType:
    """One kind of data: its names, the place of the stamp in its messages, and how a payload is made up.

    Attributes:
        name: name in the trace and in `--data`: `binary`, `string`, `imu`.
        topic: topic of the way out; that of the way back has `RELAY_SUFFIX`.
        type_name: ROS name of the message type.
        raw: its serialized messages.
        objects: its message objects, None for a type that travels serialized alone.
        object_stamp: place of the stamp in a message object, also in one that others made.
        make: makes up the payload.
    """

    name: str
    topic: str
    type_name: str
    raw: Form[bytearray, RawMessage]
    objects: Form[RosMessage, RosMessage] | None
    object_stamp: HeaderStampPlace | StringStampPlace
    make: Maker

    @property
    def relay_topic(self) -> str:
        """The topic of the way back."""
        return self.topic + RELAY_SUFFIX

    def object_form(self) -> Form[RosMessage, RosMessage]:
        """Return the form of its message objects.

        Raises:
            OptionError: the type travels serialized alone.
        """
        if self.objects is None:
            raise OptionError(f"--serialization typed: {self.type_name} is sent as raw bytes alone")
        return self.objects


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a source may need of the recording that it belongs to.

    Attributes:
        own_types: data types that are made up here, by the name of their message type.
        open_node: opens a node beside that of the ping, not started yet.
        wait_s: longest wait for a live source, in seconds.
        stop: ends that wait.
    """

    own_types: Mapping[str, DataType]
    open_node: Callable[[], Node]
    wait_s: float
    stop: threading.Event


@dataclass(frozen=True, slots=True)
class Source:
    """One kind of data that is read: files, bags, running topics.

    Attributes:
        name: text before the colon in `--data`.
        usage: form of the whole value of `--data`, such as `file:PATH`.
        open: opens the payload for the text behind the colon, for as long as the block lasts.
        check: refuses a text behind the colon that names nothing; raises an `OptionError` and opens nothing.
    """

    name: str
    usage: str
    open: Callable[[str, Surroundings], AbstractContextManager[Payload]]
    check: Callable[[str], object] = str


def check_stop(stop: threading.Event | None) -> None:
    """End the making of a payload once the recording is to stop.

    Raises:
        StoppedError: `stop` is set.
    """
    if stop is not None and stop.is_set():
        raise StoppedError("stopped before there was anything to send; nothing is recorded")


def check_held_bytes(held_bytes: int, path: Path) -> None:
    """Refuse data that does not fit into memory beside everything else.

    Raises:
        OptionError: there are more than `MAX_PAYLOAD_BYTES`.
    """
    if held_bytes > MAX_PAYLOAD_BYTES:
        raise OptionError(
            f"{path} holds more than {MAX_PAYLOAD_BYTES >> 30} GiB of data to send; all of it is held in memory, "
            "so give a part of it"
        )
