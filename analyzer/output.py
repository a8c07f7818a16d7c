"""The Parquet files: exact column types, units in the field metadata, whole or not there at all."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from analyzer.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS, Column
from tracefile import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import polars as pl

_COMPRESSION = "zstd"


def write_frames(roundtrips: pl.DataFrame, summary: pl.DataFrame, folder: Path) -> dict[str, Path]:
    """Write `roundtrips.parquet` and `summary.parquet` into `folder`, replacing those of an earlier analysis.

    Returns:
        Kind (`roundtrips`, `summary`) -> file.

    Raises:
        OutputError: the folder or a file cannot be written.
    """
    written: dict[str, Path] = {}
    for kind, frame, columns in (
        ("roundtrips", roundtrips, ROUNDTRIP_COLUMNS),
        ("summary", summary, SUMMARY_COLUMNS),
    ):
        written[kind] = folder / f"{kind}.parquet"
        write_frame(frame, columns, written[kind])
    return written


def write_frame(frame: pl.DataFrame, columns: tuple[Column, ...], path: Path) -> None:
    """Write one frame; a reader of `path` sees the old file or the new one, never half of it.

    Every field's metadata holds `unit` (where it has one) and `meaning`.
    """
    table = frame.to_arrow()
    fields = [_described(field, column) for field, column in zip(table.schema, columns, strict=True)]
    schema = pa.schema(fields)
    with _replacing(path) as unfinished:
        # Times and sequence numbers hardly repeat, so a dictionary of them is work for nothing.
        repeating = [column.name for column in columns if column.unit != "ns" and column.name != "sequence"]
        pq.write_table(table.cast(schema), unfinished, compression=_COMPRESSION, use_dictionary=repeating)


def _described(field: pa.Field, column: Column) -> pa.Field:
    metadata = {"meaning": column.meaning} | ({"unit": column.unit} if column.unit else {})
    kind = pa.string() if pa.types.is_large_string(field.type) else field.type
    return pa.field(column.name, kind, metadata=metadata)


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A file beside `path` that takes its place once it is complete."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield unfinished
        unfinished.replace(path)
    except OSError as err:
        raise OutputError(
            f"{path} cannot be written ({err.strerror or err}); give another folder with --out"
        ) from err
    finally:
        unfinished.unlink(missing_ok=True)
