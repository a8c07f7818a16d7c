"""Limits as a table of a TOML file writes them: of a plan, and of a file of limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.toml_table import TomlTable


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
                limits.check(limits.CONDITION, text, f"{table.where}: {limits.shown(metric)} =")
            yield Threshold(metric, tuple(map(str, listed)), result)
    for name, value in table.values.items():
        if isinstance(value, dict):
            if result:
                raise OptionError(f"{table.where}: {limits.shown(name)} is a table within that of a result")
            yield from read_thresholds(table.table(name), name)
