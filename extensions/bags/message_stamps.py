"""The stamp of a message in any encoding: a header in CDR or ROS 1, the first `google.protobuf.Timestamp`, `timestamp` or `stamp` in JSON."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

from dds_trace.extensions.bags import header_stamps
from dds_trace.tracefile.format.bag_metadata import RecordedTopic

from .recorded import LATEST_NS

_TEXTS = {"cdr": ("ros2msg", "ros1msg"), "ros1": ("ros1msg",)}
"""Encodings of definitions by the encoding of messages."""


class StampReader(NamedTuple):
    """How the stamp of a topic's messages is read: from each one, or from all at `place`; `has_header` where a header comes first."""

    read: Callable[[bytes], int | None]
    place: header_stamps.StampPlace | None = None
    has_header: bool = False


def stamps_of(topic: RecordedTopic) -> StampReader | None:
    name, encoding = topic.message_type, topic.encoding
    if encoding == "protobuf":
        read = _protobuf_reader(name, topic.descriptors)
        return StampReader(read) if read else None
    if encoding == "json":
        schema = topic.definition
        may_have_stamp = '"properties"' not in schema or re.search(r'"(time)?stamp"', schema)
        return StampReader(_json_stamp) if may_have_stamp else None
    is_text = topic.definition_encoding in _TEXTS.get(encoding, ())
    return _header_reader(name, topic.definition if is_text else "", encoding)


@lru_cache(maxsize=1000)
def _header_reader(name: str, definition: str, encoding: str) -> StampReader | None:
    definition = definition or header_stamps.known_definition(name, encoding)
    read = header_stamps.stamp_reader(name, definition, encoding)
    if read is None:
        return None
    first = next(iter(header_stamps.parse_definition(name, definition)[header_stamps.plain_name(name)]), None)
    has_header = first is not None and first.type == "std_msgs/Header" and first.length is None
    return StampReader(read, header_stamps.stamp_place(name, definition, encoding), has_header)


_JSON_TIME = re.compile(rb'(?<!\\)"(?:time)?stamp"\s*:\s*\{([^{}]*)\}')
_JSON_SECONDS = re.compile(rb'"secs?"\s*:\s*(-?\d{1,10})\s*(?:,|$)')
_JSON_NANOSECONDS = re.compile(rb'"n(?:ano)?secs?"\s*:\s*(\d{1,9})\s*(?:,|$)')


def _json_stamp(data: bytes) -> int | None:
    for match in _JSON_TIME.finditer(data):
        seconds, nanoseconds = _JSON_SECONDS.search(match[1]), _JSON_NANOSECONDS.search(match[1])
        if seconds and nanoseconds:
            return _in_ns(int(seconds[1]), int(nanoseconds[1]))
    return None


def _in_ns(seconds: int, nanoseconds: int) -> int | None:
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    return stamp_ns if 0 < stamp_ns <= LATEST_NS else None


_TIMESTAMP = ".google.protobuf.Timestamp"


class _Wire(IntEnum):
    VARINT = 0
    EIGHT_BYTES = 1
    BYTES = 2
    FOUR_BYTES = 5


_SIZES: Mapping[int, int] = {_Wire.EIGHT_BYTES: 8, _Wire.FOUR_BYTES: 4}


class _Number:
    """Of fields, by message, in `descriptor.proto` and `timestamp.proto`."""

    FILE = 1
    PACKAGE, MESSAGE_TYPE = 2, 4
    TYPE_NAME, FIELD, NESTED_TYPE = 1, 2, 3
    FIELD_NUMBER, FIELD_TYPE = 3, 6
    SECONDS, NANOSECONDS = 1, 2


_Types = Mapping[str, Sequence[tuple[int, str]]]
"""Number and type of each field that is a message, by message type."""


def _protobuf_reader(name: str, descriptors: bytes) -> Callable[[bytes], int | None] | None:
    """Return a reader of the first timestamp in the order of the schema; of a repeated field the first value that has one counts."""
    try:
        types = dict(_message_types(descriptors))
    except (ValueError, RecursionError):
        return None
    stamped, before = {_TIMESTAMP}, 0
    while len(stamped) > before:
        before = len(stamped)
        stamped |= {kind for kind, fields in types.items() if any(part in stamped for _, part in fields)}
    root = f".{name}"
    if root not in stamped:
        return None
    stamped_fields = {kind: [part for part in fields if part[1] in stamped] for kind, fields in types.items()}

    def read(data: bytes) -> int | None:
        try:
            return _Message(data, stamped_fields).stamp_of(root, 0, len(data))
        except (ValueError, IndexError, RecursionError):
            return None

    return read


class _Message:
    def __init__(self, data: bytes, types: _Types) -> None:
        self._data, self._types, self._steps = data, types, header_stamps.MOST_STEPS

    def stamp_of(self, kind: str, start: int, stop: int) -> int | None:
        if kind == _TIMESTAMP:
            return self._timestamp(start, stop)
        stamped, later = self._types[kind], dict[int, list[tuple[int, int]]]()
        numbers = [number for number, _ in stamped]
        for number, wire, at, end in _wire_fields(self._data, start, stop):
            self._steps -= 1
            if self._steps < 0:
                raise ValueError("too much before the stamp")
            if wire != _Wire.BYTES or number not in numbers:
                continue
            if number != numbers[0]:
                later.setdefault(number, []).append((at, end))
            elif (stamp_ns := self.stamp_of(stamped[0][1], at, end)) is not None:
                return stamp_ns
        for number, part in stamped[1:]:
            for at, end in later.get(number, ()):
                if (stamp_ns := self.stamp_of(part, at, end)) is not None:
                    return stamp_ns
        return None

    def _timestamp(self, start: int, stop: int) -> int | None:
        values = {number: at for number, wire, at, _ in _wire_fields(self._data, start, stop) if wire == _Wire.VARINT}
        return _in_ns(values.get(_Number.SECONDS, 0), values.get(_Number.NANOSECONDS, 0))


def _wire_fields(data: bytes, start: int, stop: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield number, wire type, start and end of each field in a message; for a varint its value, and 0."""
    at = start
    while at < stop:
        tag, at = _varint(data, at, stop)
        wire = tag & 7
        if wire == _Wire.VARINT:
            value, at = _varint(data, at, stop)
            yield tag >> 3, wire, value, 0
            continue
        size = _SIZES.get(wire, 0)
        if wire == _Wire.BYTES:
            size, at = _varint(data, at, stop)
        elif not size:
            raise ValueError("not protobuf")
        if size > stop - at:
            raise ValueError("longer than the message")
        yield tag >> 3, wire, at, at + size
        at += size


def _varint(data: bytes, at: int, stop: int) -> tuple[int, int]:
    value = shift = 0
    while at < stop and shift < 64:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise ValueError("a number is cut off")


def _message_types(descriptors: bytes) -> Iterator[tuple[str, list[tuple[int, str]]]]:
    """Yield the name of each message type in a `FileDescriptorSet` and its fields that are messages."""
    for _, start, stop in _parts(descriptors, 0, len(descriptors), {_Number.FILE}):
        parts = list(_parts(descriptors, start, stop, {_Number.PACKAGE, _Number.MESSAGE_TYPE}))
        packages = [descriptors[at:end].decode() for number, at, end in parts if number == _Number.PACKAGE]
        scope = "".join(f".{package}" for package in packages[-1:])
        for number, at, end in parts:
            if number == _Number.MESSAGE_TYPE:
                yield from _message_type(descriptors, at, end, scope)


def _message_type(data: bytes, start: int, stop: int, scope: str) -> Iterator[tuple[str, list[tuple[int, str]]]]:
    parts = list(_parts(data, start, stop, {_Number.TYPE_NAME, _Number.FIELD, _Number.NESTED_TYPE}))
    name = "".join(f"{scope}.{data[at:end].decode()}" for number, at, end in parts if number == _Number.TYPE_NAME)
    fields = []
    for number, at, end in parts:
        if number == _Number.NESTED_TYPE:
            yield from _message_type(data, at, end, name)
        elif number == _Number.FIELD:
            about = {part: (wire, first, last) for part, wire, first, last in _wire_fields(data, at, end)}
            wire, first, last = about.get(_Number.FIELD_TYPE, (_Wire.VARINT, 0, 0))
            if wire == _Wire.BYTES:
                fields.append((about.get(_Number.FIELD_NUMBER, (0, 0, 0))[1], data[first:last].decode()))
    yield name, fields


def _parts(data: bytes, start: int, stop: int, numbers: set[int]) -> Iterator[tuple[int, int, int]]:
    for number, wire, at, end in _wire_fields(data, start, stop):
        if wire == _Wire.BYTES and number in numbers:
            yield number, at, end
