"""The rows of `roundtrips`: taken batch by batch, then in memory where they are few, else in their Parquet file."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
import pyarrow as pa

from ..cache.parquet_join import RowPart
from ..model.columns import ROUNDTRIP_COLUMNS
from ..model.metrics import schema_of
from ..model.parameters import PARAMETER_NAMES
from .parquet import roundtrips_writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from types import TracebackType

ROUNDTRIP_NAMES = tuple(column.name for column in ROUNDTRIP_COLUMNS)

MOST_HELD_ROWS = 1_000_000
"""Rows that are kept in memory, some hundred bytes each; of more, only what is asked for is read from the file."""


class RowStore:
    """Takes the rows of a campaign batch by batch, writes them, and gives them back whole, in part or by group.

    Entered, it takes rows; left, it gives them. Left with an error, a file that was there before stays as it was.

    Args:
        path: `roundtrips.parquet`; None writes a temporary file, and that only of many rows.
        provenance: metadata of that file.

    Attributes:
        groups: once they are located, a row per group: `group` u32, the parameter columns, and `first` and
            `published` i64: its rows are those from `first` on.

    Raises:
        OutputError: the file cannot be written.
    """

    def __init__(self, path: Path | None = None, provenance: Mapping[str, str] | None = None) -> None:
        self.groups = pl.DataFrame()
        self._path = path
        self._provenance = provenance
        self._held: pl.DataFrame | list[pa.Table] | None = []
        self._rows = 0
        self._stack = ExitStack()
        self._write: Callable[[pa.Table | RowPart], None] | None = None

    @classmethod
    def of(cls, rows: pl.DataFrame | Path, summary: pl.DataFrame | None = None) -> RowStore:
        """Return a store of rows that are there already.

        Args:
            rows: a frame, or a Parquet file.
            summary: the frame `summary` of these rows, for `groups`.
        """
        store = cls(rows if isinstance(rows, Path) else None)
        store._held = None if isinstance(rows, Path) else rows
        if summary is not None:
            store.locate(summary)
        return store

    @property
    def file(self) -> Path | None:
        """The absolute path of the file of the rows, if there is one, whether or not they are in memory, too."""
        return None if self._path is None else self._path.resolve()

    def in_file(self) -> RowStore:
        """Return the same rows, all of them to be read from their file: what another process is sent is small then."""
        assert self.file is not None
        store = RowStore.of(self.file)
        store.groups = self.groups
        return store

    def __enter__(self) -> RowStore:  # noqa: PYI034 - `Self` is Python 3.11's
        """Begin the file, if one is asked for."""
        if self._path is not None:
            self._write = self._stack.enter_context(roundtrips_writer(self._path, self._provenance))
        return self

    def add(self, rows: Iterable[pa.Table | RowPart] | RowPart) -> None:
        """Take the next rows, as `parquet.tables_of` or `parquet.encode_rows` makes them."""
        for some in [rows] if isinstance(rows, RowPart) else rows:
            if isinstance(some, RowPart) and self._write is not None:
                self._held = None  # what others have encoded, and a file has, is not decoded to be held
            self._rows += some.num_rows
            if isinstance(self._held, list):
                self._held.append(some.load() if isinstance(some, RowPart) else some)
            if self._write is not None:
                self._write(some)
            if isinstance(self._held, list) and self._rows > MOST_HELD_ROWS:
                self._release(self._held)

    def _release(self, held: list[pa.Table]) -> None:
        """Leave all rows to the file, which is begun if there is none yet."""
        if self._write is None:
            folder = Path(tempfile.mkdtemp(prefix="dds-analyze-"))
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            self._path = folder / "roundtrips.parquet"
            self._write = self._stack.enter_context(roundtrips_writer(self._path, self._provenance))
            for table in held:
                self._write(table)
        self._held = None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file, or leave what was there before."""
        self._stack.__exit__(kind, error, trace)

    def load(self) -> pl.DataFrame:
        """Return all rows; those in a file are read anew at every call."""
        if self._held is None:
            assert self._path is not None
            return pl.read_parquet(self._path)
        if isinstance(self._held, list):
            self._held = _frame_of(self._held)
        return self._held

    def scan(self) -> pl.LazyFrame:
        """Return all rows, to be read when they are collected, and only the columns and rows that it takes."""
        if self._held is not None:
            return self.load().lazy()
        assert self._path is not None
        written = self._path.stat()
        return _scan(self._path, written.st_size, written.st_mtime_ns)

    def locate(self, summary: pl.DataFrame) -> None:
        """Make `groups` from the frame `summary`, one row per group in the order of the rows."""
        published = pl.col("published").cast(pl.Int64)
        self.groups = summary.select(
            pl.int_range(pl.len(), dtype=pl.UInt32).alias("group"),
            *PARAMETER_NAMES,
            (published.cum_sum() - published).alias("first"),
            published.alias("published"),
        )

    @property
    def has_rows(self) -> bool:
        """Whether there are rows; False of a sketch, which has groups only."""
        return not self.scan().head(1).collect().is_empty()

    def frame(self, groups: pl.DataFrame, columns: Sequence[str] = ROUNDTRIP_NAMES) -> pl.DataFrame:
        """Return columns of the rows of some rows of `groups`, group by group."""
        rows = self.scan().select(columns)
        spans = [rows.slice(*span) for span in zip(groups["first"], groups["published"], strict=True)]
        return (pl.concat(spans) if spans else rows.head(0)).collect()


@lru_cache(maxsize=4)
def _scan(path: Path, size: int, written_ns: int) -> pl.LazyFrame:  # noqa: ARG001 - which file it is, not its name alone
    """Return the rows of a file, whose footer is read once for all that is collected of them."""
    return pl.scan_parquet(path)


def _frame_of(tables: Sequence[pa.Table]) -> pl.DataFrame:
    """Return the rows of all tables, with texts in place of dictionaries."""
    frames = [pl.DataFrame([_series(name, table[name]) for name in table.column_names]) for table in tables]
    return pl.concat([pl.DataFrame(schema=schema_of(ROUNDTRIP_COLUMNS)), *frames]).rechunk()


def _series(name: str, column: pa.ChunkedArray) -> pl.Series:
    if not pa.types.is_dictionary(column.type):
        return pl.Series(name, column)
    parts = [pl.Series(name, c.dictionary, pl.String).gather(pl.Series(c.indices)) for c in column.chunks]
    return pl.concat([pl.Series(name, [], pl.String), *parts])
