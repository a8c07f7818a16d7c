"""JSON of frozen dataclasses, tolerant of fields of other versions."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args, get_origin, get_type_hints

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from dds_trace.tracefile.format.json_fields import Json

Record = TypeVar("Record")
Counters = TypeVar("Counters", bound="DataclassInstance")


def to_json(record: DataclassInstance) -> dict[str, Json]:
    return {field.name: _json(getattr(record, field.name)) for field in fields(record)}


def _json(value: object) -> Json:
    if is_dataclass(value) and not isinstance(value, type):
        return to_json(value)
    if isinstance(value, Mapping):
        return {str(key): _json(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_json(item) for item in value]
    assert value is None or isinstance(value, bool | int | float | str), value
    return value


def since(record: Counters, before: Counters | None, *counters: str) -> Counters:
    """Return the record with its counters (all fields if none is named) since `before`; itself if there was none before."""
    if before is None:
        return record
    names = counters or tuple(field.name for field in fields(record))
    return replace(record, **{name: getattr(record, name) - getattr(before, name) for name in names})


def from_json(kind: type[Record], data: Mapping[str, Any]) -> Record:
    """Return the dataclass `kind` of a JSON object; unknown fields are ignored, missing ones have their defaults or raise a `TypeError`."""
    hints = get_type_hints(kind)
    return kind(**{name: _value(hint, data[name]) for name, hint in hints.items() if name in data})


def _value(hint: Any, data: Any) -> Any:
    if data is None:
        return None
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return _value(next(kind for kind in arguments if kind is not type(None)), data)
    if origin is tuple:
        return tuple(_value(arguments[0], item) for item in data)
    if origin is Mapping:
        return {key: _value(arguments[1], item) for key, item in data.items()}
    if isinstance(hint, type) and issubclass(hint, tuple):
        return hint(*data)
    return from_json(hint, data) if isinstance(hint, type) and is_dataclass(hint) else data
