"""Rows and summary as CSV or Arrow."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow.parquet as pq
from polars import selectors
from polars.exceptions import PolarsError

from dds_trace.base.errors import OutputError
from dds_trace.base.files import replacing

from ..pairing.parquet import summary_table

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping

    import polars as pl

    from ..analysis import Analysis

_FORMULA = r"^([=+\-@\t\r]|::)"
_HIDDEN = r"[\p{Cc}\p{Cf}\p{Co}\p{Zl}\p{Zp}]"


def _inert(rows: pl.LazyFrame) -> pl.LazyFrame:
    """Return rows whose texts a spreadsheet does not compute (an apostrophe precedes them) and that hide nothing."""
    texts = selectors.string(include_categorical=True).cast(str)
    return rows.with_columns(texts.str.replace(_FORMULA, "'$0").str.replace_all(_HIDDEN, "\ufffd"))


EXPORTERS: Mapping[str, Callable[[pl.LazyFrame, Path], object]] = {
    "csv": lambda rows, path: _inert(rows).sink_csv(path, datetime_format="%Y-%m-%dT%H:%M:%S%.9fZ"),
    "arrow": lambda rows, path: rows.sink_ipc(path),
}


def export_tables(analysis: Analysis, kind: str, folder: str | os.PathLike[str]) -> list[Path]:
    """Write `roundtrips` and `summary` as `kind` (a key of `EXPORTERS`) into a folder, and return the two files.

    Raises:
        OutputError: a file cannot be written.
    """
    folder, written = Path(folder), []
    for name, rows in (("roundtrips", analysis.scan_roundtrips()), ("summary", analysis.summary.lazy())):
        path = folder / f"{name}.{kind}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with replacing(path) as draft:
                EXPORTERS[kind](rows, draft)
        except (OSError, PolarsError) as err:
            raise OutputError(f"{path} cannot be written ({err}); give another folder with --out") from err
        written.append(path)
    return written


def summary_parquet(analysis: Analysis) -> bytes:
    """Return `summary.parquet` for the page, with units and meanings in the metadata of its fields: 100 KB for 500 groups."""
    file = io.BytesIO()
    table = summary_table(analysis.summary)
    pq.write_table(table, file, compression="zstd", compression_level=19, write_statistics=False)
    return file.getvalue()
