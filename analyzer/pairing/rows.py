"""The rows of `roundtrips`: written table by table, read from memory where they are few, else from Parquet."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace, TracebackType

import polars as pl
import pyarrow as pa

from ..loading.spool import TemporaryFolder
from ..model.columns import ROUNDTRIP_COLUMNS
from ..model.metrics import schema_of
from ..model.parameters import PARAMETER_NAMES
from .parquet import roundtrips_writer

ROUNDTRIP_NAMES = tuple(column.name for column in ROUNDTRIP_COLUMNS)

MOST_ROWS_IN_MEMORY = 250_000
"""Most rows that stay in memory: with their making, a kilobyte each at the peak."""


class RowStore(ABC):
    """The rows of a campaign: all of them, some columns, or some groups.

    Attributes:
        groups: one row per group: `group` u32, the parameter columns, and i64 `first` and `published`, its first row and their
            number; empty before `locate`.
    """

    def __init__(self) -> None:
        self.groups = pl.DataFrame()

    @staticmethod
    def of(rows: pl.DataFrame | Path, summary: pl.DataFrame | None = None) -> RowStore:
        store = RowsInFile(rows) if isinstance(rows, Path) else RowsInMemory(rows)
        if summary is not None:
            store.locate(summary)
        return store

    @property
    @abstractmethod
    def file(self) -> Path | None:
        """Absolute path of the file of the rows, if there is one."""

    @abstractmethod
    def moved_to(self, path: Path) -> None: ...

    def load(self) -> pl.DataFrame:
        """Return all rows; those in a file are read at every call."""
        return self.scan().collect()

    @abstractmethod
    def scan(self) -> pl.LazyFrame: ...

    def locate(self, summary: pl.DataFrame) -> None:
        published = pl.col("published").cast(pl.Int64)
        self.groups = summary.select(
            pl.int_range(pl.len(), dtype=pl.UInt32).alias("group"),
            *PARAMETER_NAMES,
            (published.cum_sum() - published).alias("first"),
            published.alias("published"),
        )

    @property
    def has_rows(self) -> bool:
        """False of a sketch, which has only groups."""
        return not self.scan().head(1).collect().is_empty()

    def frame(self, groups: pl.DataFrame, columns: Sequence[str] = ROUNDTRIP_NAMES) -> pl.DataFrame:
        rows = self.scan().select(columns)
        spans = [rows.slice(*span) for span in zip(groups["first"], groups["published"], strict=True)]
        return (pl.concat(spans) if spans else rows.head(0)).collect()


class RowsInMemory(RowStore):
    """`path`: a file that has the same rows."""

    def __init__(self, rows: pl.DataFrame, path: Path | None = None) -> None:
        super().__init__()
        self._rows = rows
        self._path = path

    @property
    def file(self) -> Path | None:
        return None if self._path is None else self._path.resolve()

    def moved_to(self, path: Path) -> None:
        self._path = path

    def scan(self) -> pl.LazyFrame:
        return self._rows.lazy()


class RowsInFile(RowStore):
    def __init__(self, path: Path, folder: TemporaryFolder | None = None) -> None:
        super().__init__()
        self._path = path
        self._folder = folder

    @property
    def file(self) -> Path:
        return self._path.resolve()

    def moved_to(self, path: Path) -> None:
        self._path = path

    def scan(self) -> pl.LazyFrame:
        written = self._path.stat()
        return _scan(self._path, written.st_size, written.st_mtime_ns)


@lru_cache(maxsize=4)
def _scan(path: Path, size: int, written_ns: int) -> pl.LazyFrame:  # noqa: ARG001 - they distinguish versions of the file
    return pl.scan_parquet(path)


class RowWriter:
    """Writes the rows of a campaign; an earlier file stays after an error. Without a path many go to a temporary file."""

    def __init__(self, path: Path | None = None, provenance: Mapping[str, str] | None = None) -> None:
        self._path = path
        self._provenance = provenance
        self._tables: list[pa.Table] | None = []  # None once there are too many rows
        self._rows = 0
        self._folder: TemporaryFolder | None = None
        self._stack = ExitStack()
        self._write: Callable[[pa.Table], None] | None = None

    def __enter__(self) -> RowWriter:  # noqa: PYI034 - `Self` is Python 3.11's
        if self._path is not None:
            self._write = self._stack.enter_context(roundtrips_writer(self._path, self._provenance))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write(self, tables: Iterable[pa.Table]) -> None:
        for table in tables:
            self._rows += len(table)
            if self._write is not None:
                self._write(table)
            if self._tables is None:
                continue
            self._tables.append(table)
            if self._rows > MOST_ROWS_IN_MEMORY:
                if self._write is None:
                    self._move_to_temporary_file(self._tables)
                self._tables = None

    def store(self) -> RowStore:
        if self._tables is not None:
            frames = [pl.DataFrame([_series(n, table[n]) for n in table.column_names]) for table in self._tables]
            rows = pl.concat([pl.DataFrame(schema=schema_of(ROUNDTRIP_COLUMNS)), *frames]).rechunk()
            return RowsInMemory(rows, self._path)
        assert self._path is not None
        return RowsInFile(self._path, self._folder)

    def _move_to_temporary_file(self, tables: list[pa.Table]) -> None:
        self._folder = TemporaryFolder()
        self._path = self._folder.path / "roundtrips.parquet"
        self._write = self._stack.enter_context(roundtrips_writer(self._path, self._provenance))
        for table in tables:
            self._write(table)


def _series(name: str, column: pa.ChunkedArray) -> pl.Series:
    if not pa.types.is_dictionary(column.type):
        return _of_arrow(column).alias(name)
    parts = [_of_arrow(c.dictionary).gather(_of_arrow(c.indices)) for c in column.chunks]
    return pl.concat([pl.Series([], dtype=pl.String), *parts]).alias(name)


def _of_arrow(values: pa.Array | pa.ChunkedArray) -> pl.Series:
    # Of a pyarrow object itself, polars imports `pyarrow.compute`.
    stream = values if isinstance(values, pa.ChunkedArray) else pa.chunked_array([values])
    return pl.Series(SimpleNamespace(__arrow_c_stream__=stream.__arrow_c_stream__))
