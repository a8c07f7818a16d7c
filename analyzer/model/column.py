"""A column of a frame: its name, type, unit and meaning, from which schemas, Parquet metadata and docs are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    import polars as pl


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a frame; `unit` is empty where a value has none."""

    name: str
    dtype: type[pl.DataType] | pl.DataType
    unit: str
    meaning: str


def schema_of(columns: Iterable[Column]) -> dict[str, type[pl.DataType] | pl.DataType]:
    """Map column names to polars types, in order."""
    return {column.name: column.dtype for column in columns}
