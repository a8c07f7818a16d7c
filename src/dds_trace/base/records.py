"""Dataclasses as JSON and back; a float that JSON lacks is the text `inf`, `-inf` or `nan`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

Record = TypeVar("Record")

_NOT_FINITE = ("inf", "-inf", "nan")
_PLAIN = frozenset({str, int, bool})


def to_json(value: object, not_finite: Callable[[float], object] = str) -> Any:
    if value is None or type(value) in _PLAIN:  # nearly all values of a table
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else not_finite(value)
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        return {field.name: to_json(getattr(value, field.name), not_finite) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: to_json(item, not_finite) for name, item in value.items()}
    return [to_json(item, not_finite) for item in value] if isinstance(value, (list, tuple)) else value


@dataclass(frozen=True, slots=True)
class RecordReader:
    """Reader of what `to_json` returned, without unknown fields; `names` are types imported for type checkers only."""

    names: Mapping[str, object] = field(default_factory=dict)
    takes_defaults: bool = False

    def read(self, kind: type[Record], value: object) -> Record:
        """Return the record; a `ValueError` names the field that is not of its kind."""
        record = self.value(kind, value, kind.__name__)
        assert isinstance(record, kind)
        return record

    def value(self, hint: object, value: object, where: str) -> object:
        kind = get_origin(hint) or hint
        if isinstance(kind, type):
            kind = next((base for base in (Enum, tuple) if issubclass(kind, base)), kind)
        reader = _read_record if is_dataclass(hint) else _READERS.get(kind)
        if reader is None:
            raise ValueError(f"{where} has no type that JSON has")
        return reader(self, hint, value, where)


def from_json(kind: type[Record], value: object) -> Record:
    """Return the record of any version: missing fields have their defaults; `RecordReader.read` says what it raises."""
    return RecordReader(takes_defaults=True).read(kind, value)


def _read_record(reader: RecordReader, hint: Any, value: object, where: str) -> object:
    fields_read = _expect(dict, value, where)
    hints = get_type_hints(hint, localns=dict(reader.names))
    for each in fields(hint):
        has_default = (each.default, each.default_factory) != (MISSING, MISSING)
        if each.name not in fields_read and not (has_default and reader.takes_defaults):
            raise ValueError(f"{where} lacks {each.name}")
    there = ((name, kind) for name, kind in hints.items() if name in fields_read)
    return hint(**{name: reader.value(kind, fields_read[name], f"{where}.{name}") for name, kind in there})


def _read_union(reader: RecordReader, hint: object, value: object, where: str) -> object:
    for kind in get_args(hint):
        with suppress(ValueError):
            return reader.value(kind, value, where)
    raise ValueError(f"{where} is {value!r:.40}")


def _read_tuple(reader: RecordReader, hint: Any, value: object, where: str) -> object:
    items = _expect(list, value, where)
    kinds = get_args(hint)
    return tuple(reader.value(kinds[0], item, where) for item in items) if kinds else hint(*items)  # a NamedTuple


def _read_mapping(reader: RecordReader, hint: object, value: object, where: str) -> object:
    items = _expect(dict, value, where).items()
    return {name: reader.value(get_args(hint)[1], item, f"{where}.{name}") for name, item in items}


def _read_enum(_: RecordReader, hint: Any, value: object, where: str) -> object:
    try:
        return hint(value)
    except ValueError as err:
        raise ValueError(f"{where}: {err}") from err


def _read_float(_: RecordReader, __: object, value: object, where: str) -> object:
    if value in _NOT_FINITE:
        return float(str(value))
    # A whole number in place of a float stays one, so that a report prints it the same.
    return value if type(value) is int else _expect(float, value, where)


def _read_plain(_: RecordReader, hint: Any, value: object, where: str) -> object:
    return _expect(hint, value, where)


_READERS: Mapping[object, Callable[[RecordReader, object, object, str], object]] = {
    UnionType: _read_union,
    Union: _read_union,
    tuple: _read_tuple,
    Mapping: _read_mapping,
    Enum: _read_enum,
    float: _read_float,
    **dict.fromkeys((int, str, bool, NoneType), _read_plain),
}


def _expect(kind: type[Record], value: object, where: str) -> Record:
    if type(value) is not kind:  # bool is no int here
        raise ValueError(f"{where} is {value!r:.40}")
    return value
