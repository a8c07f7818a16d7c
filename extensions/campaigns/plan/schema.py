"""The JSON schema of plans for editors.

It accepts more than the parser: NaN, huge integers, missing data, faults of several keys.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, TypeAlias

from dds_trace.base import limits
from dds_trace.base.limits import Limit
from dds_trace.base.units import UNIT_BYTES
from dds_trace.recorder.payloads import data_types, sources

from .cells import AXES, Key
from .flows import FLOW_KEYS
from .link import LINES, PRESETS, Link
from .plan import DeviceSettings, Network, RunSettings, Search

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


INSTALLED = "installed"


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a plan; a repeated one may be written several times, as `[[name]]`."""

    meaning: str
    keys: Mapping[str, Key]
    subtables: tuple[str, ...] = ()
    is_repeated: bool = False

    @property
    def words(self) -> tuple[str, ...]:
        return (*self.keys, *self.subtables)


def _keys_of(record: type[DataclassInstance], *, without: str = "") -> dict[str, Key]:
    return {
        column.name: column.metadata["key"]
        for column in fields(record)
        if "key" in column.metadata and column.name != without
    }


def _text(meaning: str, limit: Limit = limits.TEXT, default: str = "none") -> Key:
    return Key(meaning, limit, default_words=default)


TABLES: Mapping[str, Table] = {
    "": Table(
        "At the top of the file, before any table.",
        {
            "name": _text("name of the folder below `--out`", limits.FILE_NAME, "the name of the file"),
            "description": _text("what the plan is for, in words"),
        },
        ("axes", "matrix", "exclude", "run", "devices", "flows", "network", "link", "search", "thresholds"),
    ),
    "axes": Table(
        "Every combination of the values is a result; `[axes]` is combined with each `[[matrix]]`. Several `[[axes]]` are each combined "
        "with every `[[matrix]]`, for values that belong together (a vendor and its own bridge). Each key takes one value or a list.",
        AXES,
        is_repeated=True,
    ),
    "matrix": Table("The same keys as `[axes]`.", AXES, is_repeated=True),
    "exclude": Table(
        "Results to leave out: those whose every named axis has one of the values. The same keys as `[axes]`, and",
        {**AXES, "reason": _text("why, shown by `--dry-run`")},
        is_repeated=True,
    ),
    "flows": Table(
        "Several flows on one relay, such as a camera and an IMU: each setup of `[axes]` is measured with each flow by itself, with every two, "
        "and with all at the same time, in alternating order. A flow has the keys `data`, `size` and `rate` of `[axes]`, which are then "
        "not in `[axes]`, and may have a `priority` and a `when_full` of its own, for its way out; the plan needs `[run]` `seconds`, and has no bridge ([flows](../how-to/axes.md#flows-that-disturb-each-other)).",
        FLOW_KEYS,
        is_repeated=True,
    ),
    "run": Table("What all runs have in common.", _keys_of(RunSettings)),
    "devices": Table(
        "The two devices; both are this machine unless the relay has `ssh`. Or `[[devices]]`, one for each of several `hosts`, with the keys of "
        "`[devices.relay]` ([several devices](../how-to/axes.md#several-devices)).",
        {
            "connectivity": _text(
                "the link as the traces name it: `loopback`, `wired`, `wireless`, or your own word",
                limits.NAME,
                "`loopback` on one machine, `wired` between namespaces, `emulated-NAME` over `[link]`; detected on two devices",
            )
        },
        ("ping", "relay"),
    ),
    "devices.ping": Table("The ping's device: this machine.", _keys_of(DeviceSettings, without="ssh")),
    "devices.relay": Table(
        "The relay's device. **A plan is code**: these run on both machines.", _keys_of(DeviceSettings)
    ),
    "network": Table("On one machine.", _keys_of(Network)),
    "link": Table(
        "An emulated link between two namespaces of this machine, equal in both directions.",
        {
            "preset": _text(
                f"a link to start from; single values can be changed: {'; '.join(map(str, PRESETS.values()))}",
                limits.OneOf(tuple(PRESETS)),
            ),
            **_keys_of(Link),
        },
    ),
    "search": Table("What `dds-trace capacity` looks for.", _keys_of(Search)),
    "thresholds": Table(
        "What every result has to meet, checked as the sweep ends ([exit codes](exit-codes.md)): a metric of time with its statistic, or "
        '`received_ratio`, and a condition or a list of them, such as `latency_p99 = "< 20 ms"`, `received_ratio = ">= 99.9 %"`. '
        "Metrics have the names of [`--fail-if`](../how-to/ci.md). A table in it has the name of a result ([limits.toml](../how-to/ci.md#one-file-of-limits)).",
        {},
    ),
}
"""Tables by dotted name; the root has no name."""

PLAN_LIMITS: Mapping[str, Mapping[str, Limit]] = {
    name: {word: key.limit for word, key in {**table.keys, **further}.items()}
    for name, table in TABLES.items()
    for further in [TABLES["devices.relay"].keys if name == "devices" else {}]
}


def axis_choices(name: str) -> list[str]:
    further = {"backend": [INSTALLED], "link": ["", *LINES]}
    return [*AXES[name].choices, *further.get(name, [])]


Schema: TypeAlias = "dict[str, object]"

SCHEMA_FILE_NAME = "plan.schema.json"

POINTER = f"#:schema ./{SCHEMA_FILE_NAME}"
"""First line of a plan; Taplo and Tombi find the schema by it."""

_JSON_TYPES = {str: "string", int: "integer", float: "number", bool: "boolean"}
_LINK = re.compile(r"\[([^]]+)\]\([^)]+\)")


def plan_schema() -> Schema:
    axes = TABLES["axes"].keys
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Plan of dds-trace sweep",
        "description": "Every key: docs/reference/plan-keys.md of dds-trace.",
        **_object("", TABLES[""]),
        "$defs": {name: _key("axes", name, key) for name, key in axes.items()},
    }


def schema_text() -> str:
    return json.dumps(plan_schema(), indent=2) + "\n"


def _object(name: str, table: Table) -> Schema:
    inner = {f"{name}.{word}".lstrip("."): word for word in table.subtables}
    properties: dict[str, object] = {
        word: {"$ref": f"#/$defs/{word}"} if word in TABLES["axes"].keys and key.takes_list else _key(name, word, key)
        for word, key in table.keys.items()
    }
    properties |= {word: _table(path) for path, word in inner.items()}
    return {"type": "object", "additionalProperties": False, "properties": properties, **_RULES.get(name, {})}


def _table(name: str) -> Schema:
    table = TABLES[name]
    schema: Schema = {"description": plain(table.meaning)}
    if not table.is_repeated:
        return schema | _object(name, table)
    entry = _object(name, table)
    return schema | {**entry, "type": ["object", "array"], "items": {"$ref": f"#/properties/{name}", "type": "object"}}


def _key(table: str, name: str, key: Key) -> Schema:
    value = _value(table, name, key)
    if key.takes_list:
        value = {"anyOf": [value, {"type": "array", "items": value}]}
    schema: Schema = {"description": plain(key.meaning) + (f" ({key.unit})" if key.unit else "")}
    if key.default not in (None, "", ()) and not key.default_words:
        schema["default"] = key.default
    return schema | value


def _value(table: str, name: str, key: Key) -> Schema:
    if table == "axes":
        choices = axis_choices(name)
        describe = _size if key.unit == "bytes" else _of_limit
        value: Schema = {"enum": choices} if choices else _SPECIAL_AXES.get(name, describe)(key)
        # An empty text means None.
        return {"anyOf": [value, {"const": ""}]} if key.default is None else value
    return _of_limit(key)


def _of_limit(key: Key) -> Schema:
    limit = key.limit
    return {"type": _JSON_TYPES[key.kind], **_BOUNDS[type(limit)](limit)}


def _size(key: Key) -> Schema:
    units = "|".join(sorted(filter(None, UNIT_BYTES), key=lambda unit: (-len(unit), unit)))
    letters = "".join(f"[{letter}{letter.upper()}]" if letter.isalpha() else letter for letter in units)
    text = {"type": "string", "pattern": rf"^\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*({letters})?\s*$"}
    return {"anyOf": [_of_limit(key), text]}


def _data(_: Key) -> Schema:
    text = {"type": "string", "pattern": rf"^({'|'.join(sources())}):[^\x00]+$", "maxLength": limits.TEXT.most}
    return {"anyOf": [{"enum": list(data_types())}, text]}


_SPECIAL_AXES: Mapping[str, Callable[[Key], Schema]] = {
    "rate": lambda key: {"anyOf": [_of_limit(key), {"const": "max"}]},
    "data": _data,
}


def _words(limit: limits.Words) -> Schema:
    pattern = r"[^\x00]*"
    if limit is not limits.TEXT:
        pattern = f"(?:{limit.pattern.pattern})".replace(r"\Z", "$")
        pattern = pattern.replace(r"[\w", "[A-Za-z0-9_").replace(r"\w", "[A-Za-z0-9_]")
    return {"maxLength": limit.most, "pattern": f"^{pattern}$"}


_BOUNDS: Mapping[type[Limit], Callable[..., Schema]] = {
    limits.Whole: lambda limit: {"minimum": limit.low, "maximum": limit.high},
    **dict.fromkeys(
        (limits.Real, limits.RealOrMax),
        lambda limit: {"exclusiveMinimum" if limit.is_above else "minimum": limit.low, "maximum": limit.high},
    ),
    limits.Words: _words,
    limits.OneOf: lambda limit: {"enum": list(limit.choices)},
    limits.Flag: lambda _: {},
}

_ABOVE_ZERO = {"exclusiveMinimum": 0}
_CONDITION: Schema = {"type": "string", **_words(limits.CONDITION)}
_CONDITIONS: list[Schema] = [_CONDITION, {"type": "array", "items": _CONDITION}]
_RULES: Mapping[str, Schema] = {
    "run": {
        "oneOf": [
            {"required": ["messages"], "properties": {"messages": _ABOVE_ZERO}},
            {"required": ["seconds"], "properties": {"seconds": _ABOVE_ZERO}},
            {"not": {"anyOf": [{"required": ["messages"]}, {"required": ["seconds"]}]}},
        ]
    },
    "devices": {"type": ["object", "array"], "items": {"$ref": "#/properties/devices/properties/relay"}},
    "thresholds": {
        "additionalProperties": {
            "anyOf": [*_CONDITIONS, {"type": "object", "additionalProperties": {"anyOf": _CONDITIONS}}]
        }
    },
}
"""Rules beyond single keys: a run has a length in messages or in time; thresholds have names of metrics."""


def plain(text: str) -> str:
    return _LINK.sub(r"\1", text)
