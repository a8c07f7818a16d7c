"""The stamp of each message: `dt1:` run, sequence and relay in hex, always 46 ASCII characters (`docs/trace-format.md`)."""

from __future__ import annotations

import struct
from binascii import unhexlify
from typing import NamedTuple, Protocol, TypeVar

from ..backends.node import CallMessage, RawMessage, RosMessage

STAMP_BYTES = 46
STAMP_PREFIX = b"dt1:"
PROBE_RUN_ID = 0
"""Run id of readiness probes, which relays echo and nobody records."""
NO_REPLY = (1 << 32) - 1
"""In place of a relay's id: relays record the message and do not send it back."""
NO_RELAYS = (0, NO_REPLY)
"""What stands in messages on their way out, where replies have the id of their relay."""

SentT = TypeVar("SentT")
ReceivedT_contra = TypeVar("ReceivedT_contra", contravariant=True)

_RUN = slice(4, 20)
_SEQUENCE = slice(21, 37)
_RELAY = slice(38, 46)
_SECOND_NS = 1_000_000_000
_TIME = struct.Struct("<iI")  # builtin_interfaces/Time
_NANOSECONDS_AT = 4
_LENGTH_BYTES = 4  # of a string, before its text
_pack_nanoseconds_into = struct.Struct("<I").pack_into


class Stamp(NamedTuple):
    run_id: int
    sequence: int
    relay_id: int


_from_bytes = int.from_bytes
_new_stamp = tuple.__new__  # faster than the constructor of a NamedTuple


def stamp_text(run_id: int, sequence: int, relay_id: int = 0) -> bytes:
    return b"dt1:%016x:%016x:%08x" % (run_id, sequence, relay_id)


def parse_stamp(text: bytes | bytearray | str) -> Stamp | None:
    if len(text) != STAMP_BYTES or text[:4] not in (STAMP_PREFIX, "dt1:"):
        return None
    try:
        return Stamp(*map(_number, (text[_RUN], text[_SEQUENCE], text[_RELAY])))
    except ValueError:
        return None


def _number(digits: bytes | bytearray | str) -> int:
    """Return the number of hex digits; `int` also takes a sign, blanks and underscores."""
    return _from_bytes(unhexlify(digits), "big")


class StampPlace(Protocol[SentT, ReceivedT_contra]):
    """The stamp in one kind of message, serialized or an object."""

    def write(self, message: SentT, run_id: int, sequence: int, relay_id: int = 0) -> None:
        """Write a new message's stamp; `relay_id` is 0 or `NO_REPLY`."""

    def write_second(self, message: SentT, wall_ns: int) -> int:
        """Write the second of `wall_ns` (ns since 1970) into `header.stamp`, and return its start in ns.

        With `write_nanoseconds` this writes T1, in two steps because the time between stamp and publish counts as latency.
        """

    def write_nanoseconds(self, message: SentT, nanoseconds: int) -> None:
        """Write the time since the start of the written second; it may exceed a second."""

    def read(self, message: ReceivedT_contra) -> Stamp | None:
        """Return the stamp, None if the message has none."""

    def reply(self, message: ReceivedT_contra, relay_id_text: bytes) -> SentT | None:
        """Return the message with the relay's id (8 hex digits), None if it has no stamp."""


class RawStampPlace:
    """The stamp in serialized CDR, at constant offsets of its 46 characters and of `header.stamp`, if any."""

    __slots__ = ("_end", "_last", "_nanoseconds", "_relay", "_start", "_time", "begin_at")

    def __init__(self, text_offset: int, time_offset: int | None) -> None:
        self._start = text_offset
        self.begin_at = text_offset - _LENGTH_BYTES
        self._end = text_offset + STAMP_BYTES
        self._relay = slice(text_offset + _RELAY.start, text_offset + _RELAY.stop)
        self._time = time_offset
        self._nanoseconds = None if time_offset is None else time_offset + _NANOSECONDS_AT
        self._last = (b"", 0)  # text and id of the last run

    def write(self, message: bytearray, run_id: int, sequence: int, relay_id: int = 0) -> None:
        message[self._start : self._end] = stamp_text(run_id, sequence, relay_id)

    def write_second(self, message: bytearray, wall_ns: int) -> int:
        second = wall_ns // _SECOND_NS
        if self._time is not None:
            _TIME.pack_into(message, self._time, second, 0)
        return second * _SECOND_NS

    def write_nanoseconds(self, message: bytearray, nanoseconds: int) -> None:
        offset = self._nanoseconds
        if offset is None:
            return
        if nanoseconds < _SECOND_NS:
            _pack_nanoseconds_into(message, offset, nanoseconds)
        else:
            at = offset - _NANOSECONDS_AT
            second, _ = _TIME.unpack_from(message, at)
            _TIME.pack_into(message, at, second + nanoseconds // _SECOND_NS, nanoseconds % _SECOND_NS)

    def read(self, message: RawMessage) -> Stamp | None:
        text = message[self._start : self._end]
        run_text, run_id = self._last
        if len(text) == STAMP_BYTES and text.startswith(run_text) and run_text:  # usually the same run
            try:
                sequence, relay_id = unhexlify(text[_SEQUENCE]), unhexlify(text[_RELAY])
                return _new_stamp(Stamp, (run_id, _from_bytes(sequence, "big"), _from_bytes(relay_id, "big")))
            except ValueError:
                return None
        stamp = parse_stamp(text)
        if stamp is not None:
            self._last = bytes(text[: _RUN.stop]), stamp.run_id
        return stamp

    def begin_of(self, message: RawMessage, run_id: int, sequence: int, end: int) -> bytes:
        return bytes(message[self.begin_at : self._start] + stamp_text(run_id, sequence) + message[self._end : end])

    def reply(self, message: RawMessage, relay_id_text: bytes) -> bytearray | None:
        if not message.startswith(STAMP_PREFIX, self._start) or len(message) < self._end:
            return None
        reply = message if isinstance(message, bytearray) else bytearray(message)
        reply[self._relay] = relay_id_text
        return reply


class HeaderStampPlace:
    def write(self, message: RosMessage, run_id: int, sequence: int, relay_id: int = 0) -> None:
        message.header.frame_id = stamp_text(run_id, sequence, relay_id).decode()

    def write_second(self, message: RosMessage, wall_ns: int) -> int:
        second = message.header.stamp.sec = wall_ns // _SECOND_NS
        return second * _SECOND_NS

    def write_nanoseconds(self, message: RosMessage, nanoseconds: int) -> None:
        stamp = message.header.stamp
        if nanoseconds >= _SECOND_NS:
            stamp.sec += nanoseconds // _SECOND_NS
            nanoseconds %= _SECOND_NS
        stamp.nanosec = nanoseconds

    def read(self, message: RosMessage) -> Stamp | None:
        return parse_stamp(message.header.frame_id)

    def reply(self, message: RosMessage, relay_id_text: bytes) -> RosMessage | None:
        text = message.header.frame_id
        if not text.startswith("dt1:"):
            return None
        message.header.frame_id = text[: _RELAY.start] + relay_id_text.decode()
        return message

    def make_room(self, message: RosMessage) -> None:
        self.write(message, 0, 0)


class StringStampPlace:
    """The stamp in the first 46 characters of a `std_msgs/msg/String` object."""

    def write(self, message: RosMessage, run_id: int, sequence: int, relay_id: int = 0) -> None:
        message.data = stamp_text(run_id, sequence, relay_id).decode() + message.data[STAMP_BYTES:]

    def write_second(self, message: RosMessage, wall_ns: int) -> int:  # noqa: ARG002 - the role's signature
        return wall_ns

    def write_nanoseconds(self, message: RosMessage, nanoseconds: int) -> None:
        """Write nothing: a String has no time."""

    def read(self, message: RosMessage) -> Stamp | None:
        return parse_stamp(message.data[:STAMP_BYTES])

    def reply(self, message: RosMessage, relay_id_text: bytes) -> RosMessage | None:
        text = message.data
        if not text.startswith("dt1:"):
            return None
        message.data = text[: _RELAY.start] + relay_id_text.decode() + text[STAMP_BYTES:]
        return message

    def make_room(self, message: RosMessage) -> None:
        message.data = stamp_text(0, 0).decode() + message.data


class CallStampPlace:
    def write(self, message: CallMessage, run_id: int, sequence: int, relay_id: int = 0) -> None:
        message.stamp = stamp_text(run_id, sequence, relay_id).decode()

    def write_second(self, message: CallMessage, wall_ns: int) -> int:  # noqa: ARG002 - the role's signature
        return wall_ns

    def write_nanoseconds(self, message: CallMessage, nanoseconds: int) -> None:
        """Write nothing: a call has no time."""

    def read(self, message: CallMessage) -> Stamp | None:
        return parse_stamp(message.stamp)

    def reply(self, message: CallMessage, relay_id_text: bytes) -> CallMessage | None:
        message.stamp = message.stamp[: _RELAY.start] + relay_id_text.decode()
        return message


# Encapsulation (4 bytes), then of a header: stamp (8), length of frame_id (4), text; of a String: length (4), text.
RAW_HEADER_STAMP = RawStampPlace(text_offset=16, time_offset=4)
RAW_STRING_STAMP = RawStampPlace(text_offset=8, time_offset=None)
HEADER_STAMP = HeaderStampPlace()
STRING_STAMP = StringStampPlace()
CALL_STAMP = CallStampPlace()
