"""Data that a ping sends: a `DataType` makes it up, a `Source` reads it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import MAX_PAYLOAD_BYTES

from ..backends.node import RELAY_SUFFIX, Node, RawMessage, RosMessage
from ..errors import StoppedError
from .stamp import HeaderStampPlace, SentT, StampPlace, StringStampPlace

ReceivedT = TypeVar("ReceivedT")


@dataclass(frozen=True, slots=True)
class Message:
    """One serialized message with room for the stamp, which `payload_bytes` does not count."""

    data: bytearray
    payload_bytes: int


class Feed(Protocol):
    """A live source of messages; each is sent when it arrives."""

    def begin(self) -> None:
        """Keep messages from now on."""

    def take(self, stop: threading.Event) -> tuple[Message, int] | None:
        """Wait for the next message; return it and its arrival (monotonic ns), None after `stop`."""

    @property
    def skipped(self) -> int:
        """Messages that were dropped because too many waited."""


@dataclass(frozen=True, slots=True)
class Payload:
    """The messages of a run, sent in a cycle.

    Attributes:
        payload_bytes: of the largest message.
        rate_hz: as it was recorded.
        feed: live source; then `messages` are for probes.
        notes: doubts about the source, in words.
    """

    data_type: DataType
    messages: Sequence[Message]
    payload_bytes: int
    rate_hz: float | None = None
    source: str = ""
    feed: Feed | None = None
    notes: tuple[str, ...] = ()

    def in_flow(self, name: str) -> Payload:
        return replace(self, data_type=self.data_type.in_flow(name))


@dataclass(frozen=True, slots=True)
class Form(Generic[SentT, ReceivedT]):
    """One form of a data type's messages: serialized, or as message objects.

    Attributes:
        payload_bytes_of: returns the application bytes of a received message; raises for one that is cut short.
        sizing_bytes_of: returns how many first bytes determine, with the length of the message, its `payload_bytes_of`;
            None for message objects.
        whole_bytes_of: returns the length of a response that was requested in a size of its own.
    """

    stamp: StampPlace[SentT, ReceivedT]
    payload_bytes_of: Callable[[ReceivedT], int]
    sizing_bytes_of: Callable[[RawMessage], int] | None = None
    whole_bytes_of: Callable[[Any], int] = len


MOST_PADDING_BYTES = 3
"""Some vendors pad a message to four bytes."""


def sized_by_length(_message: RawMessage) -> int:
    """Return 0: the lengths of message and first string determine the payload."""
    return 0


@dataclass(frozen=True, slots=True)
class DataType:
    """One kind of data.

    Attributes:
        topic: of the way out.
        objects: None for a type that is only sent in serialized form.
        object_stamp: place of the stamp in a message object, also of another program.
        make: makes up a payload of a size (None: the default) and a seed; raises an `OptionError` for a wrong size and a
            `StoppedError` once the event is set.
    """

    name: str
    topic: str
    type_name: str
    raw: Form[bytearray, RawMessage]
    objects: Form[RosMessage, RosMessage] | None
    object_stamp: HeaderStampPlace | StringStampPlace
    make: Callable[[int | None, int, threading.Event | None], Payload]
    flow: str = ""

    @property
    def relay_topic(self) -> str:
        return self.topic + RELAY_SUFFIX

    def in_flow(self, name: str) -> DataType:
        return replace(self, topic=f"{self.topic}_{name}", flow=name)

    def object_form(self) -> Form[RosMessage, RosMessage]:
        if self.objects is None:
            raise OptionError(f"-o serialization=typed: {self.type_name} is only sent as raw bytes")
        return self.objects


@dataclass(frozen=True, slots=True)
class PayloadContext:
    """What a source needs: built-in data types by message type, a second node, when to end."""

    own_types: Mapping[str, DataType]
    open_node: Callable[[], Node]
    wait_s: float
    stop: threading.Event


@dataclass(frozen=True, slots=True)
class Source:
    """One kind of data that is read: files, bags, running topics.

    Attributes:
        usage: form of `--data`, such as `file:PATH`; `name` is the text before the colon.
        open: opens the payload for the text after the colon; `check` raises an `OptionError` for a wrong one.
        is_live: whether the messages come while they are sent.
    """

    name: str
    usage: str
    open: Callable[[str, PayloadContext], AbstractContextManager[Payload]]
    check: Callable[[str], object] = str
    is_live: bool = False


def check_stop(stop: threading.Event | None) -> None:
    """Raise a `StoppedError` if `stop` is set."""
    if stop is not None and stop.is_set():
        raise StoppedError("stopped before there was anything to send; nothing is recorded")


def check_size(size_bytes: int, path: Path) -> None:
    """Refuse data that is too large for memory."""
    if size_bytes > MAX_PAYLOAD_BYTES:
        raise OptionError(
            f"{path} has more than {MAX_PAYLOAD_BYTES >> 30} GiB of data to send, which must fit into memory; give a part of it"
        )
