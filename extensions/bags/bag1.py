"""Messages of a rosbag1 file (format 2.0), without an index: damage is stepped over up to the next bytes that are a record again.

Chunks that are not packed are walked as a part of the file.
"""

from __future__ import annotations

import bz2
import re
import struct
from collections import deque
from collections.abc import Iterator
from contextlib import closing, suppress
from enum import IntEnum
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dds_trace.base.units import counted
from dds_trace.tracefile.format.bag_metadata import RecordedTopic
from dds_trace.tracefile.mcapfile.blocks import LARGEST_FILE_RATIO, most_unpacked_bytes
from dds_trace.tracefile.mcapfile.chunks import DamagedChunkError, unpack_records
from dds_trace.tracefile.mcapfile.file import MAX_RECORD_BYTES, RecordFile, Records
from dds_trace.tracefile.mcapfile.scan import linked, unaligned
from dds_trace.tracefile.reading.source import Budget, UnreadableError

from .kinds import BAG1_MAGIC, BLOCK_BYTES
from .recorded import NONE, Condition, Int64, MessageBatch, RawMessage, batched, full_type


class _Op(IntEnum):
    MESSAGE = 2
    BAG_HEADER = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


_NEEDED: dict[int, dict[str, int]] = {
    _Op.MESSAGE: {"conn": 4, "time": 8},
    _Op.BAG_HEADER: {"index_pos": 8},
    _Op.INDEX: {"conn": 4},
    _Op.CHUNK: {"size": 4},
    _Op.CHUNK_INFO: {"chunk_pos": 8},
    _Op.CONNECTION: {"conn": 4},
}
"""Fields of each kind of record, and their bytes."""
_LENGTH, _HEADER_LENGTH = struct.Struct("<I"), struct.Struct("<HH")
_TIME = struct.Struct("<II")
_USUAL_BYTES = len("op=.conn=....time=........") + 4 * _LENGTH.size
"""Of a message's header with its length: three fields, each after its own."""
_HEADER_START = re.compile(rb"(?=..\0\0..\0\0[a-z0-9_]{1,24}=)", re.DOTALL)
"""The lengths of a header and of its first field, both under 64 KiB, and the name of that field."""

_HEADER_START_BYTES = 64
"""Searched first after damage, and read beyond what is searched: more than `_HEADER_START` needs."""

_LARGEST_RATIOS = {"lz4": LARGEST_FILE_RATIO, "bz2": 50}
"""Most unpacked bytes per byte of the file; bz2 takes ten times as long."""

_MOST_FIELDS = 64
"""Of a header; bytes that claim more are no record."""


class _Run(NamedTuple):
    """The starts of messages that follow each other, and offsets in each."""

    starts: Int64
    conn_at: int
    time_at: int
    data_at: int


class _Record(NamedTuple):
    opcode: int
    fields: dict[str, bytes]
    at: int
    data_at: int
    end: int
    unpacked: Records | None = None
    run: _Run | None = None


def bag1_messages(path: Path, condition: Condition) -> Iterator[RawMessage]:
    return (message for batch in bag1_batches(path, condition) for message in batch.messages())


def bag1_batches(path: Path, condition: Condition) -> Iterator[MessageBatch]:
    with closing(RecordFile(path)) as file:
        for kind, items in groupby(_Bag1Walk(file, condition), type):
            in_batches: Any = iter if kind is MessageBatch else batched
            yield from in_batches(items)


class _Bag1Walk:
    def __init__(self, file: RecordFile, condition: Condition, *, looks_ahead: bool = True) -> None:
        self._file, self._condition, self._looks_ahead = file, condition, looks_ahead
        self._budget, self._unpacked_bytes = Budget(file.size), 0
        self._topics: dict[int, RecordedTopic] = {}
        self._times_ns: list[int] = []
        self._cut_at = -1

    def __iter__(self) -> Iterator[RawMessage | MessageBatch]:
        start = len(BAG1_MAGIC)
        if self._file.read(0, min(start, self._file.size)) != BAG1_MAGIC:
            first = self._resume(self._file, 0, self._file.size)
            if first is None:
                raise UnreadableError("it is not a ROS 1 bag of format 2.0")
            self._condition.damages.append(f"it does not begin as a ROS 1 bag; its first record is at byte {first}")
            start = first
        try:
            yield from self._messages(self._file, start)
            self._end_chunk()
        finally:
            self._condition.topics |= set(self._topics.values())

    def _messages(self, source: Records, at: int) -> Iterator[RawMessage | MessageBatch]:
        for record in self._records(source, at):
            if record.run is not None:
                yield from self._batch(source.read(0, source.size), record.run)
            elif record.opcode == _Op.BAG_HEADER and not self._has_index(record):
                why = "it was not closed, or is cut off"
                self._condition.damages.append(f"{why}: it has no index (`rosbag reindex` makes one)")
            elif record.opcode == _Op.CONNECTION:
                self._add_topic(record, source.read(record.data_at, record.end - record.data_at))
            elif record.opcode == _Op.CHUNK:
                self._end_chunk()
                if record.unpacked is not None:
                    yield from self._messages(record.unpacked, 0)
            elif record.opcode == _Op.MESSAGE:
                self._budget.take()
                number = _number(record, "conn")
                if number not in self._topics:
                    self._look_ahead()
                seconds, nanoseconds = _TIME.unpack(record.fields["time"])
                self._times_ns.append(seconds * 10**9 + nanoseconds)
                data = source.read(record.data_at, record.end - record.data_at)
                if number in self._topics:
                    yield RawMessage(self._topics[number], self._times_ns[-1], None, None, data)

    def _batch(self, data: bytes, run: _Run) -> Iterator[MessageBatch]:
        count, words = self._budget.take(len(run.starts)), unaligned(data, "<u4")
        starts = run.starts[:count]
        numbers, inverse = np.unique(words[starts + run.conn_at], return_inverse=True)
        if not self._topics.keys() >= {*numbers.tolist()}:
            self._look_ahead()
        log_ns = words[starts + run.time_at].astype(np.int64) * 10**9 + words[starts + run.time_at + 4]
        self._times_ns += log_ns.tolist()
        has_topic = np.array([number in self._topics for number in numbers.tolist()])
        topics = [self._topics[number] for number in numbers[has_topic].tolist()]
        none, sizes = np.full(count, NONE), words[starts + run.data_at - _LENGTH.size].astype(np.int64)
        index = (np.cumsum(has_topic) - 1)[inverse]
        batch = MessageBatch(topics, index, log_ns, none, none, data, starts + run.data_at, sizes)
        yield batch.selected(has_topic[inverse])
        if count < len(run.starts):
            self._budget.take()

    def _end_chunk(self) -> None:
        if self._times_ns:
            self._condition.chunks.append((min(self._times_ns), max(self._times_ns), len(self._times_ns)))
            self._times_ns = []

    def _look_ahead(self) -> None:
        if self._looks_ahead:
            self._looks_ahead = False
            ahead = _Bag1Walk(self._file, Condition(), looks_ahead=False)
            with suppress(UnreadableError):
                deque(ahead, 0)
            self._topics = {**ahead._topics, **self._topics}

    def _records(self, source: Records, at: int) -> Iterator[_Record]:
        """Yield records that fit what follows them, or in which no other is found, and chunks that can be unpacked."""
        following = self._record_at(source, at)
        while at < source.size:
            record = following
            if record is None:
                is_cut = self._cut_at == at
                resumed_at = self._resume(source, at + 1, source.size)
                unread = counted((resumed_at or source.size) - at, "byte")
                what = "that are no record" if resumed_at and not is_cut else "of a cut or damaged record"
                where = "" if source is self._file else "in a chunk, "
                self._condition.damages.append(f"{where}at byte {at}: {unread} {what}")
                at = resumed_at or source.size
                following = self._record_at(source, at)
                continue
            is_packed = record.opcode == _Op.CHUNK and record.fields["compression"] != b"none"
            next_at = record.end if is_packed or record.opcode != _Op.CHUNK else record.data_at
            is_open = record.opcode == _Op.CHUNK and not is_packed
            if is_open and _number(record, "size") == record.end - next_at <= source.size - next_at:
                following = self._record_at(source, record.end)
                if following is not None or record.end == source.size:
                    data = source.read(next_at, record.end - next_at)
                    yield record._replace(unpacked=Records(bytes(data)))
                    at = record.end
                    continue
            following = self._record_at(source, next_at)
            if is_packed:
                record = self._unpacked(source, record)
            is_whole = not is_packed or record.unpacked is not None
            if not is_whole or (following is None and next_at < source.size):
                inside = self._resume(source, record.data_at, next_at)
                if inside is not None:
                    is_whole &= is_packed
                    next_at, following = inside, self._record_at(source, inside)
            if is_whole:
                yield record
            at = next_at

    def _has_index(self, header: _Record) -> bool:
        at, is_empty = _number(header, "index_pos"), not any(header.fields.get("conn_count", b"1"))
        return 0 < at < self._file.size or (is_empty and at == self._file.size)

    def _record_at(self, source: Records, at: int) -> _Record | None:
        if source.size - at < 2 * _LENGTH.size:
            return None
        header_bytes, beyond = _HEADER_LENGTH.unpack(source.peek(at, _LENGTH.size))
        data_at = at + 2 * _LENGTH.size + header_bytes
        if beyond or data_at > source.size:
            return None
        header = source.peek(at + _LENGTH.size, header_bytes + _LENGTH.size)
        end = data_at + _LENGTH.unpack_from(header, header_bytes)[0]
        with suppress(struct.error, ValueError):
            record = self._record_of(source, at, data_at, end, _fields(header[:header_bytes]))
            is_container = record and record.opcode == _Op.CHUNK and record.fields["compression"] == b"none"
            if end <= source.size or is_container:
                return record
            self._cut_at = at if record else -1
        return None

    def _record_of(self, source: Records, at: int, data_at: int, end: int, fields: dict[str, bytes]) -> _Record | None:
        opcode = fields.get("op", b"\0")[0] if fields.get("op") else 0
        is_nested = opcode == _Op.CHUNK and source is not self._file
        is_short = any(len(fields.get(name, b"")) != size for name, size in _NEEDED.get(opcode, {}).items())
        if opcode not in _NEEDED or is_nested or is_short or (opcode == _Op.CHUNK and "compression" not in fields):
            return None
        if end - data_at > MAX_RECORD_BYTES:
            return None
        record = _Record(opcode, fields, at, data_at, end)
        return (
            record
            if opcode != _Op.MESSAGE or source is self._file
            else _with_alike(source.read(0, source.size), record)
        )

    def _resume(self, source: Records, start: int, stop: int) -> int | None:
        """Return the first record in a range; each byte of it is looked at once, in steps that grow."""
        at, size = start, _HEADER_START_BYTES
        while at < stop:
            size = min(size, stop - at)
            data = source.read(at, min(size + _HEADER_START_BYTES, source.size - at))
            for match in _HEADER_START.finditer(data):
                if match.start() < size and self._record_at(source, at + match.start()) is not None:
                    return at + match.start()
            at += size
            size = min(2 * size, BLOCK_BYTES)
        return None

    def _unpacked(self, source: Records, record: _Record) -> _Record:
        compression, size = record.fields["compression"].decode(errors="replace"), _number(record, "size")
        self._unpacked_bytes += max(record.end - record.data_at, size if size <= MAX_RECORD_BYTES else 0)
        ratio = _LARGEST_RATIOS.get(compression, LARGEST_FILE_RATIO)
        if self._unpacked_bytes > most_unpacked_bytes(source.size, ratio):
            raise UnreadableError(f"it unpacks to more than {ratio} times its size")
        try:
            packed = source.read(record.data_at, record.end - record.data_at)
            data = _unpack_bz2(packed, size) if compression == "bz2" else unpack_records(compression, packed, size)
        except (DamagedChunkError, ValueError, OSError, EOFError) as err:
            self._condition.damages.append(f"the chunk at byte {record.at} is damaged ({err}) and left out")
            return record
        return record._replace(unpacked=Records(bytes(data)))

    def _add_topic(self, record: _Record, data: bytes) -> None:
        try:
            about = _fields(data)
            name, kind = record.fields["topic"].decode(), about["type"].decode()
        except (struct.error, ValueError, KeyError) as err:
            self._condition.damages.append(f"the connection at byte {record.at} is damaged ({err})")
            return
        self._topics[_number(record, "conn")] = RecordedTopic(
            name,
            full_type(kind),
            "ros1",
            about.get("message_definition", b"").decode(errors="replace"),
            "ros1msg",
            "durability: transient_local" if about.get("latching") == b"1" else "",
            about.get("callerid", b"").decode(errors="replace"),
            about.get("md5sum", b"").decode(errors="replace"),
        )


def _with_alike(data: bytes, record: _Record) -> _Record:
    """Join a message of a usual header with those after it that have one alike, each whole and with another one, or the end, after it."""
    at, data_at = record.at, record.data_at - record.at
    head = data[at : at + _USUAL_BYTES]
    conn_at, time_at = (head.find(name) + len(name) for name in (b"conn=", b"time="))
    is_usual = data_at == _USUAL_BYTES + _LENGTH.size and conn_at < time_at
    if not is_usual or not data.startswith(head[:conn_at], record.end):
        return record
    spans = (0, conn_at), (conn_at + _LENGTH.size, time_at), (time_at + _TIME.size, _USUAL_BYTES)
    offsets = [min(offset, end - _LENGTH.size) for first, end in spans for offset in range(first, end, _LENGTH.size)]
    firsts, words = np.frombuffer(data, np.uint8), unaligned(data, "<u4")
    parts, size, begin, stop = [np.empty(0, np.int64)], 16 * (record.end - at), at, at
    while stop < len(data) and 2 * (at - begin) >= stop - begin:  # in windows that grow while messages fill them
        begin, stop, size = at, min(at + size, len(data)), 2 * 2 * size
        starts = at + np.flatnonzero(firsts[at : stop - data_at + 1] == head[0])
        for offset in offsets:
            starts = starts[words[starts + offset] == words[record.at + offset]]
        ends = starts + data_at + words[starts + _USUAL_BYTES]
        starts, ends = starts[ends <= stop], ends[ends <= stop]
        if len(starts) and starts[0] == at:
            is_linked = linked(starts, ends)
            parts.append(starts[is_linked])
            at = int(ends[is_linked][-1])
    starts = np.concatenate(parts)
    if len(starts) and at < len(data):
        at, starts = int(starts[-1]), starts[:-1]
    return record._replace(end=at, run=_Run(starts, conn_at, time_at, data_at)) if len(starts) else record


def _number(record: _Record, field: str) -> int:
    return int.from_bytes(record.fields[field], "little")


def _fields(header: bytes) -> dict[str, bytes]:
    fields: dict[str, bytes] = {}
    at = 0
    for _ in range(_MOST_FIELDS):
        if at == len(header):
            return fields
        (length,) = _LENGTH.unpack_from(header, at)
        at += _LENGTH.size + length
        name, sign, value = header[at - length : at].partition(b"=")
        if at > len(header) or not sign:
            break
        fields[name.decode()] = value
    raise ValueError("its header is no list of fields")


def _unpack_bz2(packed: bytes, size: int) -> bytes:
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a piece of it unpacks to more than {MAX_RECORD_BYTES >> 20} MiB")
    unpacked = bz2.BZ2Decompressor().decompress(packed, size + 1)
    if len(unpacked) != size:
        raise ValueError(f"a chunk holds {counted(len(unpacked), 'byte')} and claims {size:,}")
    return unpacked
