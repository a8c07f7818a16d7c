"""The JSON schema of a plan, by which editors complete its keys and mark what the parser would refuse.

It refuses nothing that the parser takes. What it cannot say, and the parser does: NaN and numbers outside of an integer's
type, what data and bags there are, and rules of several keys (two cells of one name, an outage of length zero, rates in the
wrong order).
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, TypeAlias

from dds_trace.base import limits
from dds_trace.base.units import UNIT_BYTES

from ...payloads import PAYLOADS, data_types
from ...payloads.base import Source
from .tables import TABLES, axis_choices

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from dds_trace.base.limits import Limit

    from .tables import Table, TableKey

Schema: TypeAlias = "dict[str, object]"

SCHEMA_FILE_NAME = "plan.schema.json"
"""Name under which the schema lies beside plans; their first line names it."""

POINTER = f"#:schema ./{SCHEMA_FILE_NAME}"
"""First line of a plan, by which Taplo, Tombi and the editors on them find the schema."""

_JSON_TYPES = {str: "string", int: "integer", float: "number", bool: "boolean"}
_LINK = re.compile(r"\[([^]]+)\]\([^)]+\)")


def plan_schema() -> Schema:
    """Return the JSON schema (draft 2020-12) of a plan's TOML file."""
    axes = TABLES["axes"].keys
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Plan of dds-sweep",
        "description": "Every key: docs/reference/plan-keys.md of dds-trace.",
        **_object("", TABLES[""]),
        "$defs": {name: _key("axes", name, key) for name, key in axes.items()},
    }


def schema_text() -> str:
    """Return the schema as the text of its file."""
    return json.dumps(plan_schema(), indent=2) + "\n"


def _object(name: str, table: Table) -> Schema:
    inner = {f"{name}.{each}".lstrip("."): each for each in table.subtables}
    properties: dict[str, object] = {word: _reference(name, word, key) for word, key in table.keys.items()}
    properties |= {word: _table(path) for path, word in inner.items()}
    return {"type": "object", "additionalProperties": False, "properties": properties, **_RULES.get(name, {})}


def _table(name: str) -> Schema:
    table = TABLES[name]
    said: Schema = {"description": plain(table.meaning)}
    if not table.is_repeated:
        return said | _object(name, table)
    # A table or an array of them: what is no table is no object, so that the properties do not concern it.
    one = _object(name, table)
    return said | {
        **one,
        "type": ["object", "array"],
        "items": {"$ref": f"#/properties/{name}", "type": "object"},
    }


def _reference(table: str, name: str, key: TableKey) -> Schema:
    """Return a key; those of `[axes]` are said once, as three tables have them."""
    return (
        {"$ref": f"#/$defs/{name}"}
        if name in TABLES["axes"].keys and key.takes_list
        else _key(table, name, key)
    )


def _key(table: str, name: str, key: TableKey) -> Schema:
    value = _value(table, name, key)
    if key.takes_list:
        value = {"anyOf": [value, {"type": "array", "items": value}]}
    said: Schema = {"description": plain(key.key.meaning) + (f" ({key.key.unit})" if key.key.unit else "")}
    # A default in words is that of the whole plan, not of the key.
    if key.default not in (None, "", ()) and not key.key.default:
        said["default"] = key.default
    return said | value


def _value(table: str, name: str, key: TableKey) -> Schema:
    """Return what one value of a key may be."""
    if table == "axes":
        choices = axis_choices(name)
        value: Schema = {"enum": choices} if choices else _AXES.get(name, _of_limit)(key)
        # An empty text is the None of an axis that may be None.
        return {"anyOf": [value, {"const": ""}]} if key.default is None else value
    return _of_limit(key)


def _of_limit(key: TableKey) -> Schema:
    limit = key.key.limit
    return {"type": _JSON_TYPES[key.kind], **_BOUNDS[type(limit)](limit)}


def _size(key: TableKey) -> Schema:
    units = "|".join(sorted(filter(None, UNIT_BYTES), key=lambda unit: (-len(unit), unit)))
    letters = "".join(f"[{letter}{letter.upper()}]" if letter.isalpha() else letter for letter in units)
    text = {"type": "string", "pattern": rf"^\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*({letters})?\s*$"}
    return {"anyOf": [_of_limit(key), text]}


def _data(_: TableKey) -> Schema:
    sources = [name for name, payload in PAYLOADS.items() if isinstance(payload, Source)]
    text = {
        "type": "string",
        "pattern": rf"^({'|'.join(sources)}):[^\x00]+$",
        "maxLength": limits.TEXT.most,
    }
    return {"anyOf": [{"enum": list(data_types())}, text]}


_AXES: Mapping[str, Callable[[TableKey], Schema]] = {"size": _size, "data": _data}
"""Axes of which a value is more than its type and validator tell."""


def _words(limit: limits.Words) -> Schema:
    """Return the length and the pattern of a text, with letters and end spelled as every engine reads them."""
    pattern = r"[^\x00]*"
    if limit is not limits.TEXT:
        pattern = f"(?:{limit.pattern.pattern})".replace(r"\Z", "$")
        pattern = pattern.replace(r"[\w", "[A-Za-z0-9_").replace(r"\w", "[A-Za-z0-9_]")
    return {"maxLength": limit.most, "pattern": f"^{pattern}$"}


_BOUNDS: Mapping[type[Limit], Callable[..., Schema]] = {
    limits.Whole: lambda limit: {"minimum": limit.low, "maximum": limit.high},
    limits.Real: lambda limit: {
        "exclusiveMinimum" if limit.is_above else "minimum": limit.low,
        "maximum": limit.high,
    },
    limits.Words: _words,
    limits.OneOf: lambda limit: {"enum": list(limit.choices)},
    limits.Flag: lambda _: {},
}
"""Kind of validator -> its bounds as the schema says them."""

_ABOVE_ZERO = {"exclusiveMinimum": 0}
_RULES: Mapping[str, Schema] = {
    "run": {
        "oneOf": [
            {"required": ["messages"], "properties": {"messages": _ABOVE_ZERO}},
            {"required": ["seconds"], "properties": {"seconds": _ABOVE_ZERO}},
            {"not": {"anyOf": [{"required": ["messages"]}, {"required": ["seconds"]}]}},
        ]
    },
}
"""Table -> its rules of several keys: a run has a length in messages or in time."""


def plain(text: str) -> str:
    """Return a meaning without the addresses of its links."""
    return _LINK.sub(r"\1", text)
