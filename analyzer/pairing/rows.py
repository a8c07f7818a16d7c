"""The rows of `roundtrips` once they are all there: in memory where they are few, else in their Parquet file."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
import pyarrow as pa

from ..model.column import schema_of
from ..model.columns import ROUNDTRIP_COLUMNS
from ..model.parameters import PARAMETER_NAMES
from .parquet import RoundTripsWriter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

ROUNDTRIP_NAMES = tuple(column.name for column in ROUNDTRIP_COLUMNS)

MOST_HELD_ROWS = 1_000_000
"""Rows that are kept in memory, some hundred bytes each; of more, only what is asked for is read from the file."""


class RoundTripRows:
    """The rows of a campaign, wherever they are.

    Args:
        held: the rows in memory, as a frame or as they were written (made a frame when first wanted); or None.
        path: the Parquet file that has them, where they are not in memory.
        folder: a temporary folder with that file; it goes away with this.
    """

    def __init__(
        self,
        held: pl.DataFrame | Sequence[pa.Table] | None,
        path: Path | None = None,
        folder: Path | None = None,
    ) -> None:
        self._held = held
        self._path = path
        if folder is not None:
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    @classmethod
    def none(cls) -> RoundTripRows:
        """No rows: they were not brought here."""
        return cls(pl.DataFrame(schema=schema_of(ROUNDTRIP_COLUMNS)))

    def frame(self) -> pl.DataFrame:
        """All rows; those in a file are read anew at every call."""
        if self._held is None:
            assert self._path is not None
            return pl.read_parquet(self._path)
        if not isinstance(self._held, pl.DataFrame):
            self._held = _frame_of(self._held)
        return self._held

    def scan(self) -> pl.LazyFrame:
        """All rows, to be read when they are collected, and only the columns and rows that it takes."""
        return self.frame().lazy() if self._path is None else pl.scan_parquet(self._path)


class RowsByGroup:
    """The rows of some groups at a time, read from wherever they are.

    Args:
        rows: by group, as the batches made them.
        summary: the frame `summary`, one row per group in the same order.

    Attributes:
        rows: all of them.
        groups: the parameter columns of each group, `group` u32, and `first` and `published` i64: its rows are
            those from `first` on.
    """

    def __init__(self, rows: RoundTripRows, summary: pl.DataFrame) -> None:
        self.rows = rows
        published = pl.col("published").cast(pl.Int64)
        self.groups = summary.select(
            pl.int_range(pl.len(), dtype=pl.UInt32).alias("group"),
            *PARAMETER_NAMES,
            (published.cum_sum() - published).alias("first"),
            published.alias("published"),
        )

    @property
    def has_rows(self) -> bool:
        """False of a sketch, which has groups and no rows."""
        return not self.rows.scan().head(1).collect().is_empty()

    def frame(self, groups: pl.DataFrame, columns: Sequence[str] = ROUNDTRIP_NAMES) -> pl.DataFrame:
        """Some columns of the rows of some of `groups`."""
        rows = self.rows.scan().select(columns)
        spans = groups.select("first", "published").iter_rows()
        return pl.concat([rows.head(0), *(rows.slice(*span) for span in spans)]).collect()

    def column(self, group: int, name: str) -> pl.Series:
        """One column of the rows of one group, so that a group of any size can be looked at."""
        span = self.groups.select("first", "published").row(group)
        return self.rows.scan().select(name).slice(*span).collect().to_series()


class RowKeeper:
    """Takes rows batch by batch, writes them, and holds them while they are few.

    Args:
        path: `roundtrips.parquet`; None writes a temporary file, and that only of many rows.

    Raises:
        OutputError: the file cannot be written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._held: list[pa.Table] = []
        self._rows = 0
        self._stack = ExitStack()
        self._folder: Path | None = None
        self._writer: RoundTripsWriter | None = None

    def __enter__(self) -> RowKeeper:  # noqa: PYI034 - `Self` is Python 3.11's
        """Begin the file, if one is asked for."""
        if self._path is not None:
            self._writer = self._stack.enter_context(RoundTripsWriter(self._path))
        return self

    def add(self, table: pa.Table) -> None:
        """Take the rows of the next batch."""
        self._rows += len(table)
        if self._writer is not None:
            self._writer.write(table)
        if self._rows <= MOST_HELD_ROWS:
            self._held.append(table)
            return
        if self._writer is None:
            self._folder = Path(tempfile.mkdtemp(prefix="dds-analyze-"))
            self._writer = self._stack.enter_context(RoundTripsWriter(self._folder / "roundtrips.parquet"))
            for early in (*self._held, table):
                self._writer.write(early)
        self._held.clear()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file, or leave what was there before."""
        self._stack.__exit__(kind, error, trace)
        if error is not None and self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def finished(self) -> RoundTripRows:
        """The rows, after the file is complete."""
        if self._rows <= MOST_HELD_ROWS:
            return RoundTripRows(tuple(self._held))
        assert self._writer is not None
        return RoundTripRows(None, self._writer.path, self._folder)


def _frame_of(tables: Sequence[pa.Table]) -> pl.DataFrame:
    """The rows of all tables, with texts in place of dictionaries."""
    frames = [pl.DataFrame([_series(name, table[name]) for name in table.column_names]) for table in tables]
    return pl.concat([pl.DataFrame(schema=schema_of(ROUNDTRIP_COLUMNS)), *frames]).rechunk()


def _series(name: str, column: pa.ChunkedArray) -> pl.Series:
    if not pa.types.is_dictionary(column.type):
        return pl.Series(name, column)
    parts = [pl.Series(name, c.dictionary, pl.String).gather(pl.Series(c.indices)) for c in column.chunks]
    return pl.concat([pl.Series(name, [], pl.String), *parts])
