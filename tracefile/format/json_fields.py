"""JSON of a trace as typed values: the type itself, and the fields of a description taken one by one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from ..errors import TraceFormatError

if TYPE_CHECKING:
    from pathlib import Path

T = TypeVar("T")

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
"""A value of JSON; objects are mappings, arrays are sequences, numbers are int or float."""

JsonObject: TypeAlias = Mapping[str, Json]
"""A JSON object, which is what every description and every sample is."""

FORMAT_VERSION = 1
"""Version of the descriptions' JSON, written into each. Version 1: first version (2026)."""


class DescriptionFields:
    """JSON object from a trace, taken field by field; what is left at the end is unknown to this version.

    Every method that takes a field raises `TraceFormatError` if it is missing or of another type.

    Args:
        left: the object; each field that is taken is removed from it.
        path: the trace, for errors.
        what: the name of the description, for errors.
    """

    def __init__(self, left: dict[str, Json], path: Path | str, what: str) -> None:
        self._left = left
        self._path = path
        self._what = what

    @classmethod
    def parse(cls, text: str, path: Path | str, what: str) -> DescriptionFields:
        """Parse a description and check that its format version is `FORMAT_VERSION`.

        Raises:
            TraceFormatError: `text` is no JSON object, or of another version.
        """
        try:
            described = json.loads(text)
        except ValueError as err:
            raise TraceFormatError(path, f"the {what} description is not JSON ({err})") from err
        if not isinstance(described, dict):
            raise TraceFormatError(path, f"the {what} description is not a JSON object")
        fields = cls(described, path, what)
        version = fields.integer("format")
        if version != FORMAT_VERSION:
            raise TraceFormatError(
                path,
                f"the {what} description has format {version}, this version reads {FORMAT_VERSION}; "
                "update dds-trace on this machine",
            )
        return fields

    def nested(self, name: str) -> DescriptionFields:
        """Take a field that is an object with fields of its own."""
        return DescriptionFields(self.mapping(name), self._path, f"{self._what}.{name}")

    def text(self, name: str) -> str:
        """Take a string."""
        return self._take(name, str, "a string")

    def integer(self, name: str) -> int:
        """Take an integer."""
        return self._take(name, int, "an integer")

    def number(self, name: str) -> float:
        """Take an integer or a float."""
        value = self._pop(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(name, value, "a number")
        return float(value)

    def mapping(self, name: str) -> dict[str, Json]:
        """Take an object as it is."""
        return self._take(name, dict, "an object")

    def hex_id(self, name: str) -> int:
        """Take a 64-bit number written as 16 hex digits."""
        text = self.text(name)
        try:
            value = int(text, 16)
        except ValueError:
            value = -1
        if len(text) != 16 or value < 0:
            raise self._wrong(name, text, "16 hex digits")
        return value

    def optional(self, name: str, kind: type[T]) -> T | None:
        """Take a value of type `kind`, or None where the field is null."""
        if name in self._left and self._left[name] is None:
            del self._left[name]
            return None
        return self._take(name, kind, f"null or {kind.__name__}")

    def rest(self) -> dict[str, Json]:
        """Return the fields that were not taken."""
        return self._left

    def _pop(self, name: str) -> Json:
        if name not in self._left:
            raise TraceFormatError(self._path, f"the {self._what} description has no field {name!r}")
        return self._left.pop(name)

    def _take(self, name: str, kind: type[T], kind_name: str) -> T:
        value = self._pop(name)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self._wrong(name, value, kind_name)
        return value

    def _wrong(self, name: str, value: Json, kind_name: str) -> TraceFormatError:
        return TraceFormatError(
            self._path, f"field {name!r} of the {self._what} description is {value!r}, not {kind_name}"
        )
