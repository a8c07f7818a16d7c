"""Frozen dataclasses as JSON and back, equal or refused; a float that JSON lacks is the text `inf`, `-inf` or `nan`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import TypeVar, Union, get_args, get_origin, get_type_hints

from ..model.finding import Finding, Source
from ..statistics.intervals import Interval
from ..verdicts.answers import CaseAnswer
from ..verdicts.job import Job
from ..verdicts.judgements import Judgement
from ..verdicts.recommend import Recommendation

Record = TypeVar("Record")

_NOT_FINITE = ("inf", "-inf", "nan")

_NAMES = {
    "CaseAnswer": CaseAnswer,
    "Finding": Finding,
    "Interval": Interval,
    "Job": Job,
    "Judgement": Judgement,
    "Mapping": Mapping,
    "Recommendation": Recommendation,
    "Setting": Mapping[str, str | int | float | None],
    "Source": Source,
}


@dataclass(frozen=True, slots=True)
class Content:
    """All fields of `Analysis` and `Details` but the frames; `sessions` and `runs` are JSON texts."""

    title: str
    sources: tuple[Source, ...]
    sessions: tuple[str, ...]
    runs: tuple[str, ...]
    timeline_decimated: bool
    findings: tuple[Finding, ...]
    outputs: Mapping[str, str]
    answers: tuple[CaseAnswer, ...]
    deadline_ns: int | None
    deadline_metric: str
    recommendation: Recommendation | None
    requested: bool
    unsent: Mapping[str, int]


_PLAIN = frozenset({str, int, bool})


def to_json(value: object, not_finite: Callable[[float], object] = str) -> object:
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


def from_json(kind: type[Record], value: object) -> Record:
    """Return the record from the value of `to_json`.

    Raises:
        ValueError: `value` is not of this kind; the message names the field.
    """
    record = _read(kind, value, kind.__name__)
    assert isinstance(record, kind)
    return record


def _read(hint: object, value: object, where: str) -> object:
    plain = Enum if isinstance(hint, type) and issubclass(hint, Enum) else hint
    reader = _read_record if is_dataclass(hint) else _READERS.get(get_origin(hint) or plain)
    if reader is None:
        raise ValueError(f"{where} has no type that JSON has")
    return reader(hint, value, where)


def _read_record(hint: object, value: object, where: str) -> object:
    assert isinstance(hint, type)
    fields_read = _expect(dict, value, where)
    hints = get_type_hints(hint, localns=_NAMES)
    for name in hints:
        if name not in fields_read:
            raise ValueError(f"{where} lacks {name}")
    return hint(**{name: _read(kind, fields_read[name], f"{where}.{name}") for name, kind in hints.items()})


def _read_union(hint: object, value: object, where: str) -> object:
    for kind in get_args(hint):
        with suppress(ValueError):
            return _read(kind, value, where)
    raise ValueError(f"{where} is {value!r:.40}")


def _read_tuple(hint: object, value: object, where: str) -> object:
    kind = get_args(hint)[0]
    return tuple(_read(kind, item, where) for item in _expect(list, value, where))


def _read_mapping(hint: object, value: object, where: str) -> object:
    kind = get_args(hint)[1]
    items = _expect(dict, value, where).items()
    return {name: _read(kind, item, f"{where}.{name}") for name, item in items}


def _read_enum(hint: object, value: object, where: str) -> object:
    assert isinstance(hint, type)
    try:
        return hint(value)
    except ValueError as err:
        raise ValueError(f"{where}: {err}") from err


def _read_float(_: object, value: object, where: str) -> object:
    if value in _NOT_FINITE:
        return float(str(value))
    # A whole number in place of a float stays one, so that a report prints it the same.
    return value if type(value) is int else _expect(float, value, where)


def _read_plain(hint: object, value: object, where: str) -> object:
    assert isinstance(hint, type)
    return _expect(hint, value, where)


_READERS: Mapping[object, Callable[[object, object, str], object]] = {
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
