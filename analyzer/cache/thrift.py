"""Thrift's compact protocol, in which the footer of a Parquet file is written: read whatever it holds, written as it was.

https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md. A footer is passed on with a few numbers
changed, so that fields are known by their numbers alone, and those that a later version of the format adds are kept.
"""

from __future__ import annotations

from typing import Any, NamedTuple

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, _, STRUCT = range(1, 13)

_STOP = 0
_LONG_LIST = 15  # from so many elements on, their number stands behind the head
_MOST_DELTA = 15  # between the numbers of two fields


class Value(NamedTuple):
    """A value with its type.

    Attributes:
        kind: `I32`, `LIST` and so on; of a bool the kind is all there is.
        value: an integer, bytes (of `DOUBLE`, too), a `Struct`, or `Elements`.
    """

    kind: int
    value: Any


class Elements(NamedTuple):
    """The elements of a list.

    Attributes:
        kind: of each.
        values: what `Value.value` of each would be; of bools their kinds.
    """

    kind: int
    values: list[Any]


Struct = dict[int, Value]
"""Field number -> value."""


def read_struct(data: bytes) -> Struct:
    """Return the struct that begins with the first byte.

    Raises:
        ValueError: the bytes are no such struct, or one with a map.
    """
    try:
        return _Reader(data).struct()
    except (IndexError, RecursionError) as err:
        raise ValueError(f"no Thrift struct ({err})") from err


def write_struct(fields: Struct) -> bytes:
    """Return the bytes of a struct."""
    into = bytearray()
    _write_struct(into, fields)
    return bytes(into)


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def struct(self) -> Struct:
        fields: Struct = {}
        number = 0
        while (head := self._data[self._at]) != _STOP:
            self._at += 1
            number = number + (head >> 4) if head >> 4 else self._signed()
            kind = head & 15
            fields[number] = Value(kind, None if kind in (TRUE, FALSE) else self._value(kind))
        self._at += 1
        return fields

    def _value(self, kind: int) -> Any:
        if kind in (I16, I32, I64):
            return self._signed()
        if kind == BINARY:
            return self._bytes(self._unsigned())
        if kind == STRUCT:
            return self.struct()
        if kind in (LIST, SET):
            (head,) = self._bytes(1)
            count = head >> 4 if head >> 4 < _LONG_LIST else self._unsigned()
            return Elements(head & 15, [self._value(head & 15) for _ in range(count)])
        if kind in (BYTE, TRUE, FALSE):
            return self._bytes(1)[0]
        if kind == DOUBLE:
            return self._bytes(8)
        raise ValueError(f"no Thrift struct (kind {kind})")

    def _bytes(self, count: int) -> bytes:
        begin, self._at = self._at, self._at + count
        if self._at > len(self._data):
            raise IndexError("it ends early")
        return self._data[begin : self._at]

    def _unsigned(self) -> int:
        number = shift = 0
        while True:
            byte = self._data[self._at]
            self._at += 1
            number |= (byte & 0x7F) << shift
            if byte < 0x80:
                return number
            shift += 7

    def _signed(self) -> int:
        folded = self._unsigned()
        return (folded >> 1) ^ -(folded & 1)


def _write_struct(into: bytearray, fields: Struct) -> None:
    before = 0
    for number, (kind, value) in sorted(fields.items()):
        if 0 < number - before <= _MOST_DELTA:
            into.append((number - before) << 4 | kind)
        else:
            into.append(kind)
            _write_signed(into, number)
        before = number
        if kind not in (TRUE, FALSE):
            _write_value(into, kind, value)
    into.append(_STOP)


def _write_value(into: bytearray, kind: int, value: Any) -> None:
    if kind in (I16, I32, I64):
        _write_signed(into, value)
    elif kind == BINARY:
        _write_unsigned(into, len(value))
        into += value
    elif kind == STRUCT:
        _write_struct(into, value)
    elif kind in (LIST, SET):
        count = len(value.values)
        into.append(min(count, _LONG_LIST) << 4 | value.kind)
        if count >= _LONG_LIST:
            _write_unsigned(into, count)
        for element in value.values:
            _write_value(into, value.kind, element)
    elif kind == DOUBLE:
        into += value
    else:
        into.append(value)


def _write_unsigned(into: bytearray, number: int) -> None:
    while number >= 0x80:
        into.append(number & 0x7F | 0x80)
        number >>= 7
    into.append(number)


def _write_signed(into: bytearray, number: int) -> None:
    _write_unsigned(into, number << 1 if number >= 0 else (-number << 1) - 1)
