"""JSON of frozen dataclasses: written whole, read with tolerance for fields that this version does not know."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args, get_origin, get_type_hints

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from dds_trace.tracefile.format.json_fields import Json, JsonObject

Record = TypeVar("Record")


def to_json(record: DataclassInstance) -> dict[str, Json]:
    """Return the JSON object of a dataclass: objects for dataclasses and mappings, arrays for tuples."""
    return {each.name: _json(getattr(record, each.name)) for each in fields(record)}


def _json(value: object) -> Json:
    if is_dataclass(value) and not isinstance(value, type):
        return to_json(value)
    if isinstance(value, Mapping):
        return {str(name): _json(each) for name, each in value.items()}
    if isinstance(value, tuple):
        return [_json(each) for each in value]
    assert value is None or isinstance(value, bool | int | float | str), value
    return value


def from_json(kind: type[Record], data: JsonObject) -> Record:
    """Return the dataclass `kind` of a JSON object.

    A field that `kind` does not have is skipped (a newer version wrote it); one that `data` does not have keeps its
    default (an older version wrote it).

    Raises:
        TypeError: `data` lacks a field that has no default.
    """
    hints = get_type_hints(kind)
    known = {name: _value(hint, data[name]) for name, hint in hints.items() if name in data}
    return kind(**known)


def _value(hint: Any, data: Any) -> Any:
    """Return `data` in the type `hint`: a dataclass, tuple or mapping of such, an optional one, or a plain value."""
    if data is None:
        return None
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return _value(next(each for each in arguments if each is not type(None)), data)
    if origin is tuple:
        return tuple(_value(arguments[0], each) for each in data)
    if origin is Mapping:
        return {name: _value(arguments[1], each) for name, each in data.items()}
    return from_json(hint, data) if isinstance(hint, type) and is_dataclass(hint) else data
