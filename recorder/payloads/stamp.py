"""The stamp that travels in each message: `dt1:` run, sequence and relay in hex, 46 ASCII characters.

Always the same length, so that it is patched in place in a serialized buffer. `docs/trace-format.md`.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

if TYPE_CHECKING:
    from ..backends.base import RawMessage

STAMP_BYTES = 46
STAMP_PREFIX = b"dt1:"
PROBE_RUN_ID = 0
"""Readiness probes carry it; relays echo them and nobody records them."""

_RUN = slice(4, 20)
_SEQUENCE = slice(21, 37)
_RELAY = slice(38, 46)
_TIME = struct.Struct("<iI")  # builtin_interfaces/Time


class Stamp(NamedTuple):
    """What one stamp says."""

    run_id: int
    sequence: int
    relay_id: int


def stamp_text(run_id: int, sequence: int, relay_id: int = 0) -> bytes:
    """The 46 characters."""
    return b"dt1:%016x:%016x:%08x" % (run_id, sequence, relay_id)


def parse_stamp(text: bytes | bytearray | str) -> Stamp | None:
    """The numbers in the 46 characters of `text`, or None if they are not a stamp of ours."""
    if len(text) != STAMP_BYTES or text[:4] not in (STAMP_PREFIX, "dt1:"):
        return None
    try:
        return Stamp(int(text[_RUN], 16), int(text[_SEQUENCE], 16), int(text[_RELAY], 16))
    except ValueError:
        return None


class StampPlace(Protocol):
    """Where one kind of message keeps the stamp, as serialized bytes or as a message object."""

    def write(self, message: Any, run_id: int, sequence: int) -> None:
        """Put the stamp of a new message in place, relay 0."""

    def write_time(self, message: Any, wall_ns: int) -> None:
        """Put T1's wall clock (ns since 1970) into `header.stamp`, where the message has one."""

    def read(self, message: Any) -> Stamp | None:
        """The stamp, or None if this is not a message of ours."""

    def reply(self, message: Any, relay_id_text: bytes) -> Any:
        """The message as relay `relay_id_text` (8 hex digits) sends it back, or None if it is not ours."""


class RawStampPlace:
    """The stamp in serialized CDR, at an offset that is the same for every message of the type.

    Args:
        text_offset: of the 46 characters from the buffer's first byte (encapsulation included).
        time_offset: of `header.stamp`, None where there is no header.
    """

    __slots__ = ("_end", "_relay", "_start", "_time")

    def __init__(self, text_offset: int, time_offset: int | None) -> None:
        self._start = text_offset
        self._end = text_offset + STAMP_BYTES
        self._relay = slice(text_offset + _RELAY.start, text_offset + _RELAY.stop)
        self._time = time_offset

    def write(self, message: bytearray, run_id: int, sequence: int) -> None:
        """Put the stamp in place in the buffer."""
        message[self._start : self._end] = stamp_text(run_id, sequence)

    def write_time(self, message: bytearray, wall_ns: int) -> None:
        """Put the wall clock into the buffer's `header.stamp`."""
        if self._time is not None:
            _TIME.pack_into(message, self._time, wall_ns // 1_000_000_000, wall_ns % 1_000_000_000)

    def read(self, message: RawMessage) -> Stamp | None:
        """The stamp, from its 46 bytes alone."""
        return parse_stamp(message[self._start : self._end])

    def reply(self, message: RawMessage, relay_id_text: bytes) -> bytearray | None:
        """A copy with the relay's id in place; the received buffer belongs to the middleware's binding."""
        if not message.startswith(STAMP_PREFIX, self._start):
            return None
        copy = bytearray(message)
        copy[self._relay] = relay_id_text
        return copy


class TypedHeaderStampPlace:
    """The stamp in `header.frame_id` of a message object."""

    def write(self, message: Any, run_id: int, sequence: int) -> None:
        """Put the stamp into `header.frame_id`."""
        message.header.frame_id = stamp_text(run_id, sequence).decode()

    def write_time(self, message: Any, wall_ns: int) -> None:
        """Put the wall clock into `header.stamp`."""
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(wall_ns, 1_000_000_000)

    def read(self, message: Any) -> Stamp | None:
        """The stamp in `header.frame_id`."""
        return parse_stamp(message.header.frame_id)

    def reply(self, message: Any, relay_id_text: bytes) -> Any:
        """The same object with the relay's id in place."""
        text = message.header.frame_id
        if not text.startswith("dt1:"):
            return None
        message.header.frame_id = text[: _RELAY.start] + relay_id_text.decode()
        return message


class TypedStringStampPlace:
    """The stamp in the first 46 characters of a `std_msgs/msg/String` object."""

    def write(self, message: Any, run_id: int, sequence: int) -> None:
        """Put the stamp before the payload."""
        message.data = stamp_text(run_id, sequence).decode() + message.data[STAMP_BYTES:]

    def write_time(self, message: Any, wall_ns: int) -> None:
        """A String has no time."""

    def read(self, message: Any) -> Stamp | None:
        """The stamp before the payload."""
        return parse_stamp(message.data[:STAMP_BYTES])

    def reply(self, message: Any, relay_id_text: bytes) -> Any:
        """The same object with the relay's id in place."""
        text = message.data
        if not text.startswith("dt1:"):
            return None
        message.data = text[: _RELAY.start] + relay_id_text.decode() + text[STAMP_BYTES:]
        return message


# std_msgs/Header comes first in both types: stamp (8 bytes) after the encapsulation (4), then the length of
# frame_id (4). A String begins with its length (4).
RAW_HEADER_STAMP = RawStampPlace(text_offset=16, time_offset=4)
RAW_STRING_STAMP = RawStampPlace(text_offset=8, time_offset=None)
TYPED_HEADER_STAMP = TypedHeaderStampPlace()
TYPED_STRING_STAMP = TypedStringStampPlace()
