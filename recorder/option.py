"""A row of the table of options, as metadata of a field, and the values that options are read as."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import Enum
from types import NoneType
from typing import TYPE_CHECKING, Any, TypeVar

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.limits import Limit, Real, Whole, shown
from dds_trace.base.units import SECOND_NS, parse_duration, parse_rate, parse_size, split_quantity

from .choices import Role

if TYPE_CHECKING:
    from dds_trace.tracefile.format.json_fields import Json
    from dds_trace.tracefile.writing.destination import TraceDestination


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


AGE_UNITS_S = {"s": 1, "min": 60, "h": 3600, "d": 86_400}


def parse_percentage(name: str, text: str) -> float:
    try:
        share = float(text.strip().removesuffix("%")) / 100
    except ValueError:
        share = -1.0
    if not text.strip().endswith("%") or not 0 <= share <= 1:
        raise OptionError(f"{name} {text!r}: write a percentage from 0% to 100%, for example 1%")
    return share


def parse_pairs(name: str, texts: Iterable[str], example: str) -> dict[str, str]:
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise OptionError(f"{name} {text!r}: write KEY=VALUE, for example {example}")
        pairs[key] = value
    return pairs


def parse_topics(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for text in texts for name in text.split(",") if name.strip()))


def parse_seconds(text: str, what: str) -> float:
    """Read a duration with a unit, or a number of seconds; `what` names the option."""
    try:
        return float(text)
    except ValueError:
        value, unit = split_quantity(text) or (0.0, "")
        return value * AGE_UNITS_S[unit] if unit in AGE_UNITS_S else parse_duration(text, what) / SECOND_NS


def parse_rate_or_max(text: str) -> float:
    try:
        rate_hz = math.inf if text == "max" else float(text)
    except ValueError:
        return parse_rate(text, "--rate")
    if text != "max" and not math.isfinite(rate_hz):
        raise OptionError(f"--rate {shown(text)} is not finite; write a rate in messages a second, or max")
    return rate_hz


def parse_rates(texts: Iterable[str]) -> dict[str, float]:
    pairs = parse_pairs("-o expect", texts, "/camera/image=30")
    return {name: parse_rate(text, f"-o expect={name}") for name, text in pairs.items()}


@dataclass(frozen=True, slots=True)
class Rotation:
    file_bytes: int | None = None
    age_s: float | None = None
    keep: int | None = None

    @classmethod
    def parse(cls, text: str) -> Rotation:
        file_bytes: int | None = None
        age_s: float | None = None
        for part in text.split(","):
            value, unit = split_quantity(part.strip()) or (0.0, "")
            if unit in AGE_UNITS_S and age_s is None:
                age_s = value * AGE_UNITS_S[unit]
            elif unit.endswith("b") and file_bytes is None:
                file_bytes = parse_size(part.strip(), "-o rotate")
            else:
                raise OptionError(
                    f"-o rotate={shown(text)}: write a size, an age (s, min, h, d) or both: 1GB, 1h, 1GB,1h"
                )
        return cls(file_bytes, age_s)

    def check(self, destination: TraceDestination) -> None:
        limits.check(limits.FILE_BYTES, self.file_bytes, "-o rotate")
        limits.check(limits.FILE_AGE_S, self.age_s, "-o rotate")
        limits.check(limits.RETAINED_FILES, self.keep, "-o keep")
        if destination.is_bag:
            raise OptionError(
                "-o rotate writes .mcap files: give --out NAME.mcap, which becomes NAME.00001.mcap and so on"
            )
        if destination.force:
            raise OptionError("-o rotate overwrites nothing and numbers on from the last file; remove --force")


@dataclass(frozen=True, slots=True)
class KeepFree:
    """The disk space to leave free: a share (0 to 1) or `most_bytes`, whichever is less."""

    share: float = 0.05
    most_bytes: int | None = 1_000_000_000

    @classmethod
    def parse(cls, text: str) -> KeepFree:
        if text.strip().endswith("%"):
            return cls(parse_percentage("-o keep_free", text), None)
        return cls(1.0, parse_size(text, "-o keep_free"))

    def floor_bytes(self, disk_bytes: int) -> int:
        share_bytes = int(self.share * disk_bytes)
        return share_bytes if self.most_bytes is None else min(share_bytes, self.most_bytes)
