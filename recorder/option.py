"""A row of the table of options, as metadata of a field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import Enum
from types import NoneType
from typing import TYPE_CHECKING, Any, TypeVar

from dds_trace.base.limits import Real, Whole

from .choices import Role

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from dds_trace.base.limits import Limit
    from dds_trace.tracefile.format.json_fields import Json


_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Axis:
    """An option as a key of `[axes]`; what is empty is the option's."""

    for_relay: bool = True
    meaning: str = ""
    default: object = None
    kind: type | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Option:
    """One option of a recording.

    Attributes:
        metavar: name of the value; empty for a flag.
        kind: type on the command line; an Enum's values are the choices.
        roles: the only roles that take it; empty for all that have its record.
        variables: variables of ROS 2 that override a configured default.
    """

    name: str
    help: str
    metavar: str
    kind: type
    limit: Limit | None
    parse: Callable[[Any], object] | None
    default: str
    roles: tuple[Role, ...]
    in_key: bool
    axis: Axis | None
    variables: tuple[str, ...]
    field_default: object

    @property
    def is_repeatable(self) -> bool:
        return isinstance(self.field_default, tuple | dict)

    def read(self, text: Any) -> object:
        if self.field_default is True:  # --no-own-cost
            return False
        if self.parse is not None:
            return self.parse(text)
        return tuple(text) if self.is_repeatable else text


OUTSIDE_OF_KEY = {"in_key": False}
"""Metadata of a field that is no option and no setting."""


def option(
    default: _T,
    name: str,
    help: str,  # noqa: A002 - typer's word
    *,
    kind: type | None = None,
    limit: Limit | None = None,
    parse: Callable[[Any], object] | None = None,
    roles: tuple[Role, ...] = (),
    in_key: bool = True,
    axis: Axis | None = None,
    variables: tuple[str, ...] = (),
) -> _T:
    """Return a field that is an option; `name` includes the metavar, `help` the default in words."""
    if kind is None and isinstance(default, NoneType | tuple | dict):
        kind = str if parse is not None else {Whole: int, Real: float}.get(type(limit), str)
    name, _, metavar = name.partition(" ")
    text, _, default_words = help.partition(" Default: ")
    kind = kind or type(default)
    row = Option(
        name, text, metavar, kind, limit, parse, default_words, roles, in_key, axis, variables, field_default=default
    )
    if isinstance(default, dict):
        return field(default_factory=dict, metadata={"option": row})  # type: ignore[return-value]
    return field(default=default, metadata={"option": row})


def detail(default: _T, name: str, help: str, **row: Any) -> _T:  # noqa: A002 - typer's word
    return option(default, name, help, in_key=False, **row)


def options_of(record: Any) -> dict[str, Option]:
    return {column.name: column.metadata["option"] for column in fields(record) if "option" in column.metadata}


def changed_settings(record: object) -> Iterator[tuple[str, Json]]:
    assert is_dataclass(record)
    for column in fields(record):
        value = getattr(record, column.name)
        row = column.metadata.get("option")
        if not (column.metadata.get("in_key", True) if row is None else row.in_key):
            continue
        default = column.default if column.default_factory is MISSING else column.default_factory()
        if is_dataclass(value):
            yield from changed_settings(value)
        elif isinstance(value, Mapping):
            yield from value.items()
        elif value != default:
            yield column.name, _json_of(value)


def _json_of(value: object) -> Json:
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return [_json_of(item) for item in value]
    return value if isinstance(value, bool | int | float) else str(value)
