"""Messages in a buffer of MCAP records, found as arrays.

Events of ours are records of one length (`docs/trace-format.md`); at the first mismatch of opcode, length or CDR header a record
is stepped over by its own length. Messages of others have any length: the bytes that can begin one are linked by their lengths.
"""

from __future__ import annotations

import struct
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from ..format.encoding import MESSAGE_HEADER, RECORD_HEADER
from ..format.events import EVENT_CDR, EVENT_DTYPE, EVENT_HEAD, EVENT_RECORD_BYTES, EVENT_RECORD_DTYPE, Records
from .records import Buffer

MESSAGES_AND_CHANNELS = frozenset({Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL})
"""Opcodes of the records in a chunk."""

_CHECKED = struct.Struct(f"<QB{MESSAGE_HEADER.size}xH")
_BLOCK_DTYPE = np.dtype(f"V{EVENT_RECORD_BYTES}")

_SINGLE_STEPS = 16  # so few events cost less one by one than as an array
# The first stretch is short because a run may be. The others fit the core's cache: three comparisons read memory once.
_FIRST_STRETCH = 256
_STRETCH = 4096
_FEW_CHANNELS = 6  # ids in so small a range are searched one by one, faster than sorted


_WALKED = 16
"""Messages that are walked one by one before windows are searched, each twice as long while messages fill it."""

_WINDOW_BYTES = 1 << 18
_LONG_BYTES = 2048
"""Mean length of a message from which on walking is faster than searching."""

Int64 = NDArray[np.int64]


class ChannelEvents(NamedTuple):
    channel_id: int
    last_number: int
    events: Records


@dataclass(slots=True)
class Scan:
    """Records in a buffer: of a trace of ours `runs` of events, of other files the starts of `messages`; and the `others`."""

    runs: list[tuple[int, int]] = field(default_factory=list)
    others: list[tuple[int, int, int]] = field(default_factory=list)
    messages: list[Int64] = field(default_factory=list)
    end: int = 0
    steps: int = 0
    skipped: int = 0

    def extend(self, following: Scan) -> None:
        joins = (
            self.runs
            and following.runs
            and self.runs[-1][0] + self.runs[-1][1] * EVENT_RECORD_BYTES == following.runs[0][0]
        )
        if joins:
            offset, count = self.runs.pop()
            self.runs.append((offset, count + following.runs[0][1]))
        self.runs += following.runs[1:] if joins else following.runs
        self.others += following.others
        self.messages += following.messages
        self.end = following.end
        self.steps += following.steps

    def message_starts(self) -> Int64:
        return np.concatenate([np.empty(0, np.int64), *self.messages])

    def has_short(self, data: Buffer, least_bytes: Mapping[Opcode, int]) -> bool:
        if any(length < least_bytes[Opcode(opcode)] for opcode, _, length in self.others):
            return True
        starts = self.message_starts()
        return bool(len(starts) and lengths_at(data, starts).min() < least_bytes[Opcode.MESSAGE])

    def contents(self, data: Buffer, channel_id: int) -> list[tuple[int, int]]:
        length = EVENT_RECORD_BYTES - RECORD_HEADER.size
        offsets: list[tuple[int, int]] = []
        for offset, count in self.runs:
            records = np.frombuffer(data, EVENT_RECORD_DTYPE, count, offset)
            starts = (
                offset + RECORD_HEADER.size + np.flatnonzero(records["channel_id"] == channel_id) * EVENT_RECORD_BYTES
            )
            offsets += [(start, length) for start in starts.tolist()]
        return offsets

    def events(self, data: Buffer) -> Records:
        # Joined as blocks of bytes: for records numpy would make a new dtype.
        parts = [np.frombuffer(data, _BLOCK_DTYPE, count, offset) for offset, count in self.runs]
        joined = parts[0] if len(parts) == 1 else np.concatenate([np.empty(0, _BLOCK_DTYPE), *parts])
        return joined.view(EVENT_RECORD_DTYPE)


def scan_records(
    data: Buffer,
    start: int,
    stop: int,
    opcodes: Container[int] = MESSAGES_AND_CHANNELS,
    *,
    only: bool = False,
    is_trace: bool = True,
) -> Scan:
    """Scan the records in `data[start:stop]`; list the other records of `opcodes` besides the events of a trace, or besides all messages."""
    scan = Scan()
    at = start
    steps = 0
    while at < stop:
        steps += 1
        if not is_trace:
            at = _add_messages(data, at, stop, scan.messages)
        elif count := _count_events(data, at, stop):
            scan.runs.append((at, count))
            at += count * EVENT_RECORD_BYTES
        if stop - at < RECORD_HEADER.size:
            break
        opcode, length = RECORD_HEADER.unpack_from(data, at)
        content = at + RECORD_HEADER.size
        if opcode == 0 or length > stop - content:
            break
        if opcode in opcodes:
            scan.others.append((opcode, content, length))
        elif only:
            break
        else:
            scan.skipped += 1
        at = content + length
    scan.end, scan.steps = at, steps
    return scan


def scan_indexed(data: Buffer, start: int, stop: int, starts: Int64) -> Scan | None:
    """Return the scan of `data[start:stop]` where messages begin at `starts` and all others between them; None where an index is wrong."""
    starts = np.sort(starts)
    if not len(starts) or starts[0] < start or starts[-1] > stop - RECORD_HEADER.size:
        return None
    lengths = lengths_at(data, starts)
    ends = starts + lengths + RECORD_HEADER.size
    following = np.append(starts[1:], stop)
    is_message = np.frombuffer(data, np.uint8)[starts] == Opcode.MESSAGE
    if not (is_message & (lengths >= 0) & (lengths <= stop) & (ends <= following)).all():
        return None
    gaps = np.flatnonzero(ends < following)
    scan, index = Scan(), 0
    for first, last, until in [
        (start, int(starts[0]), 0),
        *zip(ends[gaps].tolist(), following[gaps].tolist(), (gaps + 1).tolist(), strict=True),
    ]:
        between = scan_records(data, first, last, is_trace=False)
        if last not in (between.end, stop):
            return None
        scan.messages.append(starts[index:until])
        index = until
        scan.extend(between)
        scan.skipped += between.skipped
    scan.messages.append(starts[index:])
    scan.end = between.end if len(gaps) and following[gaps[-1]] == stop else stop
    return scan


def lengths_at(data: Buffer, starts: Int64) -> Int64:
    lengths: Int64 = unaligned(data, "<i8")[starts + 1]
    return lengths


def unaligned(data: Buffer | bytearray, kind: str) -> NDArray[Any]:
    dtype = np.dtype(kind)
    values: NDArray[Any] = np.ndarray((max(len(data) - dtype.itemsize + 1, 0),), dtype, data, 0, (1,))
    return values


def _add_messages(data: Buffer, at: int, stop: int, message_starts: list[Int64]) -> int:
    """Add the starts of messages that follow one another from `at` on, and return where the last one ends."""
    while True:
        first, walked = at, list[int]()
        while len(walked) < _WALKED and stop - at >= RECORD_HEADER.size:
            opcode, length = RECORD_HEADER.unpack_from(data, at)
            if opcode != Opcode.MESSAGE or length > stop - at - RECORD_HEADER.size:
                break
            walked.append(at)
            at += RECORD_HEADER.size + length
        if walked:
            message_starts.append(np.array(walked, np.int64))
        if len(walked) < _WALKED:
            return at
        window_bytes = 4 * (at - first) if at - first < _WALKED * _LONG_BYTES else 0
        while window_bytes:
            starts, end = _linked_messages(data, at, min(stop, at + window_bytes))
            message_starts.append(starts)
            window_bytes = min(2 * window_bytes, _WINDOW_BYTES) if 2 * (end - at) > window_bytes else 0
            at = end


def _linked_messages(data: Buffer, at: int, stop: int) -> tuple[Int64, int]:
    """Return the starts of messages from `at` on, each where the previous one ends, and where the last one that ends by `stop` does."""
    size = stop - at
    starts = np.flatnonzero(np.frombuffer(data, np.uint8, max(size - RECORD_HEADER.size + 1, 0), at) == Opcode.MESSAGE)
    lengths = lengths_at(data, starts + at)
    ends = starts + lengths + RECORD_HEADER.size
    is_inside = (lengths >= 0) & (lengths <= size) & (ends <= size)
    starts, ends = starts[is_inside], ends[is_inside]
    if not len(starts) or starts[0]:
        return starts[:0], at
    is_linked = linked(starts, ends)
    return starts[is_linked] + at, at + int(ends[is_linked][-1])


def linked(starts: Int64, ends: Int64) -> NDArray[np.bool_]:
    """Return which pieces follow one another from the first on, by their ascending starts: bytes in one may look like others."""
    following = np.searchsorted(starts, ends)
    is_followed = following < len(starts)
    is_followed[is_followed] = starts[following[is_followed]] == ends[is_followed]
    breaks = np.flatnonzero((following != np.arange(1, len(starts) + 1)) | ~is_followed)
    is_linked, index = np.ones(len(starts), np.bool_), 0
    for at_break in breaks.tolist():
        if at_break >= index:
            index = int(following[at_break]) if is_followed[at_break] else len(starts)
            is_linked[at_break + 1 : index] = False
    return is_linked


def single_record(opcode: int, length: int, *, is_trace: bool) -> Scan:
    if opcode == Opcode.MESSAGE and not is_trace:
        return Scan(messages=[np.zeros(1, np.int64)])
    return Scan(others=[(opcode, RECORD_HEADER.size, length)], steps=1)


def split_by_channel(records: Records) -> list[ChannelEvents]:
    if not len(records):
        return []
    channels = np.ascontiguousarray(records["channel_id"])
    # Copied as blocks of bytes: a third of the time of a copy by field.
    numbers, events = records["number"], records["event"]
    first, last = int(channels.min()), int(channels.max())
    if first == last:
        return [ChannelEvents(first, int(numbers[-1]), events.copy().view(EVENT_DTYPE))]
    if last - first < _FEW_CHANNELS:
        positions = [(channel, np.flatnonzero(channels == channel)) for channel in range(first, last + 1)]
    else:
        order = np.argsort(channels, kind="stable")
        counts = np.bincount(channels)
        ids = np.flatnonzero(counts)
        positions = list(zip(ids.tolist(), np.split(order, np.cumsum(counts[ids])[:-1]), strict=True))
    return [
        ChannelEvents(channel, int(numbers[index[-1]]), events[index].view(EVENT_DTYPE))
        for channel, index in positions
        if len(index)
    ]


def _count_events(data: Buffer, at: int, stop: int) -> int:
    remaining = (stop - at) // EVENT_RECORD_BYTES
    count = 0
    while count < min(remaining, _SINGLE_STEPS):
        if _CHECKED.unpack_from(data, at + count * EVENT_RECORD_BYTES) != (EVENT_HEAD, 0, EVENT_CDR):
            return count
        count += 1
    stretch = _FIRST_STRETCH
    while count < remaining:
        size = min(stretch, remaining - count)
        records = np.frombuffer(data, EVENT_RECORD_DTYPE, size, at + count * EVENT_RECORD_BYTES)
        good = records["head"] == EVENT_HEAD
        good &= records["length_top"] == 0
        good &= records["cdr"] == EVENT_CDR
        if not good.all():
            return count + int(np.argmin(good))
        count += size
        stretch = _STRETCH
    return count
