"""Sections of limits by result, each with patterns of its columns; which one counts for a result is looked up, not tried."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from dds_trace.base.errors import OptionError
from dds_trace.base.limits import CONDITION, check, shown
from dds_trace.base.toml_table import TomlTable

Patterns = tuple[tuple[str, str], ...]
"""Columns of a result, each with a pattern of its value."""

TOPIC = "topic"
"""Column of a section about a topic, whatever its name begins with."""
_ESCAPED, _WILD = re.compile(r"\[([*?[ ])\]"), re.compile(r"[*?[]")


@dataclass(frozen=True, slots=True)
class Threshold:
    """Conditions such as `< 20 ms` on a metric of the results that fit a pattern, all if it is empty."""

    metric: str
    conditions: tuple[str, ...]
    result: str = ""
    accepted: str = ""


def read_thresholds(table: TomlTable, result: str = "") -> Iterator[Threshold]:
    """Yield the conditions of a table for all results, then of its tables, which have the name of a result."""
    for metric, value in table.values.items():
        if not isinstance(value, dict):
            listed = value if isinstance(value, list) else [value]
            for text in listed:
                check(CONDITION, text, f"{table.where}: {shown(metric)} =")
            yield Threshold(metric, tuple(map(str, listed)), result)
    for name, value in table.values.items():
        if isinstance(value, dict):
            if result:
                raise OptionError(f"{table.where}: {shown(name)} is a table within that of a result")
            yield from read_thresholds(table.table(name), name)


def _literal(pattern: str) -> str | None:
    """Return the only text that fits; None where several may."""
    return None if _WILD.search(_ESCAPED.sub("", pattern)) else _ESCAPED.sub(r"\1", pattern)


def _matcher(pattern: str) -> Callable[[str], object]:
    return re.compile(fnmatch.translate(pattern)).match


def fits_any(pattern: str, names: Collection[str]) -> bool:
    literal = _literal(pattern)
    return bool(fnmatch.filter(names, pattern)) if literal is None else literal in names


_Section = tuple[int, list[tuple[str, Callable[[str], object]]]]
"""A section's number, and its columns with wildcards."""


@dataclass(slots=True, eq=False)
class Sections:
    """The sections of a file, in its order; for each kind of limit, the last section that fits a result counts."""

    _numbers: dict[Patterns, int] = field(default_factory=dict)
    _columns: dict[str, None] = field(default_factory=dict)
    _by_columns: dict[tuple[str, ...], dict[tuple[str, ...], list[_Section]]] = field(default_factory=dict)
    """Columns without wildcards -> their values -> sections."""
    _limits: dict[Hashable, dict[int, list[int]]] = field(default_factory=dict)
    """Kind of limit -> section -> orders of its limits."""
    _fitting: dict[tuple[str, ...], tuple[int, ...]] = field(default_factory=dict)

    def add(self, patterns: Patterns, kind: Hashable, order: int) -> None:
        number = self._numbers.get(patterns)
        if number is None:
            number = self._numbers[patterns] = len(self._numbers)
            self._columns.update(dict.fromkeys(column for column, _ in patterns))
            literals = [(column, text) for column, pattern in patterns if (text := _literal(pattern)) is not None]
            wild = [(column, _matcher(pattern)) for column, pattern in patterns if _literal(pattern) is None]
            by_values = self._by_columns.setdefault(tuple(column for column, _ in literals), {})
            by_values.setdefault(tuple(text for _, text in literals), []).append((number, wild))
        self._limits.setdefault(kind, {}).setdefault(number, []).append(order)

    def are_several(self, kind: Hashable) -> bool:
        return len(self._limits[kind]) > 1

    def counting(self, kind: Hashable, row: Mapping[str, object]) -> list[int]:
        limits = self._limits[kind]
        ordered = sorted((order, section) for section in self._fitting_of(row) for order in limits.get(section, ()))
        others = [order for order, section in ordered if section != ordered[-1][1]]
        return [order for order, _ in ordered if not others or order > others[-1]]

    def fitting(self, rows: Iterable[Mapping[str, object]]) -> frozenset[Patterns]:
        numbers = {number for row in rows for number in self._fitting_of(row)}
        return frozenset(patterns for patterns, number in self._numbers.items() if number in numbers)

    def _fitting_of(self, row: Mapping[str, object]) -> tuple[int, ...]:
        texts = {column: _text(row, column) for column in self._columns}
        key = tuple(texts.values())
        if key not in self._fitting:
            self._fitting[key] = tuple(
                number
                for columns, by_values in self._by_columns.items()
                for number, wild in by_values.get(tuple(texts[column] for column in columns), ())
                if all(fits(texts[column]) for column, fits in wild)
            )
        return self._fitting[key]


def _text(row: Mapping[str, object], column: str) -> str:
    value = row["data_type" if column == TOPIC else column]
    return f"{value:g}" if isinstance(value, float) else str(value)
