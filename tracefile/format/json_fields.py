"""JSON of a trace as typed values: the type, and the fields of a description one by one."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias, TypeVar

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.limits import STORED_INTEGER, Limit, shown

T = TypeVar("T")

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
"""Objects are mappings, arrays are sequences, numbers are int or float."""

JsonObject: TypeAlias = Mapping[str, Json]
"""Every description and every sample is one."""

FORMAT_VERSION = 1
"""Version 1: first version (2026), written into each description."""


def parse_json(text: str) -> Json:
    r"""Return the value of a JSON text from a trace, safe for every library of an analysis.

    A lone surrogate, which no encoding has, is spelled out (`\udcff`); numbers keep their values.
    """
    try:
        value: Json = json.loads(text, parse_int=_integer)
        return _encodable(value) if _SURROGATE.search(text) else value
    except RecursionError as err:
        raise ValueError("it is nested deeper than any description") from err


_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_MAX_DIGITS = 20


def _integer(digits: str) -> int:
    # The length first: int() of a million digits needs seconds, and of more than 4300 it raises its own error.
    if len(digits) > _MAX_DIGITS or STORED_INTEGER.fault(int(digits)) is not None:
        raise ValueError(f"an integer of {len(digits)} digits does not fit into 64 bits")
    return int(digits)


def _encodable(value: Json) -> Json:
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, Mapping):
        return {str(_encodable(key)): _encodable(item) for key, item in value.items()}
    return [_encodable(item) for item in value] if isinstance(value, Sequence) else value


class DescriptionFields:
    """JSON object from a trace, taken field by field; one that is missing or of another type is a `TraceFormatError`."""

    def __init__(self, fields: dict[str, Json], path: Path | str, what: str) -> None:
        self._unread = fields
        self._path = path
        self._what = what

    @classmethod
    def parse(cls, text: str, path: Path | str, what: str) -> DescriptionFields:
        try:
            value = parse_json(text)
        except ValueError as err:
            raise TraceFormatError(path, f"the {what} description is not JSON ({err})") from err
        if not isinstance(value, dict):
            raise TraceFormatError(path, f"the {what} description is not a JSON object")
        fields = cls(value, path, what)
        version = fields.integer("format")
        if version != FORMAT_VERSION:
            raise TraceFormatError(
                path,
                f"the {what} description has format {version}, this version reads {FORMAT_VERSION}; "
                "update dds-trace on this machine",
            )
        return fields

    def nested(self, name: str) -> DescriptionFields:
        return DescriptionFields(self.mapping(name), self._path, f"{self._what}.{name}")

    def text(self, name: str) -> str:
        return self._take(name, str, "a string")

    def integer(self, name: str, limit: Limit = STORED_INTEGER) -> int:
        return self._limited(name, self._take(name, int, "an integer"), limit)

    def number(self, name: str, limit: Limit) -> float:
        value = self._pop(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(name, value, "a number")
        return float(self._limited(name, value, limit))

    def mapping(self, name: str) -> dict[str, Json]:
        return self._take(name, dict, "an object")

    def hex_id(self, name: str) -> int:
        text = self.text(name)
        try:
            value = int(text, 16)
        except ValueError:
            value = -1
        if len(text) != 16 or value < 0:
            raise self._wrong(name, text, "16 hex digits")
        return value

    def optional(self, name: str, kind: type[T], limit: Limit | None = None) -> T | None:
        """Take a value of type `kind` within `limit`, or null."""
        if name in self._unread and self._unread[name] is None:
            del self._unread[name]
            return None
        value = self._take(name, kind, f"null or {kind.__name__}")
        return value if limit is None else self._limited(name, value, limit)

    def rest(self) -> dict[str, Json]:
        return self._unread

    def _limited(self, name: str, value: T, limit: Limit) -> T:
        fault = limit.fault(value)
        if fault is not None:
            raise TraceFormatError(
                self._path, f"field {name!r} of the {self._what} description is {shown(value)}; {fault}"
            )
        return value

    def _pop(self, name: str) -> Json:
        if name not in self._unread:
            raise TraceFormatError(self._path, f"the {self._what} description has no field {name!r}")
        return self._unread.pop(name)

    def _take(self, name: str, kind: type[T], kind_name: str) -> T:
        value = self._pop(name)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self._wrong(name, value, kind_name)
        return value

    def _wrong(self, name: str, value: Json, kind_name: str) -> TraceFormatError:
        return TraceFormatError(
            self._path, f"field {name!r} of the {self._what} description is {shown(value)}, not {kind_name}"
        )


def object_of(value: object) -> JsonObject:
    return value if isinstance(value, dict) else {}


def objects_of(values: object) -> list[JsonObject]:
    return [object_of(value) for value in values] if isinstance(values, list) else []


def number_of(value: object) -> float | None:
    """Return a number that fits into 64 bits, else None (NaN too)."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if is_number and -(2.0**63) < value < 2.0**63 else None  # type: ignore[operator,return-value]  # narrowed above
