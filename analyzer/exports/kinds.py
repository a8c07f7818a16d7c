"""Kinds of `--export`, each with the function that writes it into a folder; rows and summary as CSV or Arrow are here.

The command lists the kinds in its help, so polars and what a kind needs are imported at use.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import OutputError
from dds_trace.base.extension import offers
from dds_trace.base.files import replacing

if TYPE_CHECKING:
    import polars as pl

    from ..analysis import Analysis

_FORMULA = r"^([=+\-@\t\r]|::)"
_HIDDEN = r"[\p{Cc}\p{Cf}\p{Co}\p{Zl}\p{Zp}]"


def _without_hidden(rows: pl.LazyFrame) -> pl.LazyFrame:
    from polars import selectors

    return rows.with_columns(selectors.string().str.replace_all(_HIDDEN, "\ufffd"))


def _inert(rows: pl.LazyFrame) -> pl.LazyFrame:
    """Return rows whose texts a spreadsheet does not compute (an apostrophe precedes them) and that hide nothing."""
    from polars import selectors

    texts = selectors.string(include_categorical=True).cast(str)
    return rows.with_columns(texts.str.replace(_FORMULA, "'$0").str.replace_all(_HIDDEN, "\ufffd"))


def _hex_ids(rows: pl.LazyFrame) -> pl.LazyFrame:
    """Return rows with run ids as 16 hex digits: readers of CSV round numbers from 2^63 on."""
    import polars as pl

    def hex_of(ids: pl.Series) -> pl.Series:
        unique = ids.unique()
        texts = pl.Series([f"{run_id:016x}" for run_id in unique], dtype=pl.String)
        return ids.to_frame("id").select(pl.col("id").replace_strict(unique, texts, return_dtype=pl.String)).to_series()

    if "run_id" not in rows.collect_schema():
        return rows
    return rows.with_columns(pl.col("run_id").map_batches(hex_of, return_dtype=pl.String, is_elementwise=True))


EXPORTERS: Mapping[str, Callable[[pl.LazyFrame, Path], object]] = {
    "csv": lambda rows, path: _inert(_hex_ids(rows)).sink_csv(path, datetime_format="%Y-%m-%dT%H:%M:%S%.9fZ"),
    "arrow": lambda rows, path: _without_hidden(rows).sink_ipc(path),
}


TOPIC_EXPORTS = (*EXPORTERS, "perfetto")
"""Kinds that the recordings of other tools have: they have no round trips."""


def write_file(path: Path, write: Callable[[Path], object]) -> Path:
    """Let `write` write a draft, which then replaces the file; its folder is made. Return the path.

    Raises:
        OutputError: the file cannot be written.
    """
    from polars.exceptions import PolarsError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft:
            write(draft)
    except (OSError, PolarsError) as err:
        raise OutputError(f"{path} cannot be written ({err}); give another --out") from err
    return path


def write_text_file(path: Path, text: str) -> Path:
    """Replace a file as `write_file` does."""
    return write_file(path, lambda draft: draft.write_text(text, encoding="utf-8", newline="\n"))


def export_tables(analysis: Analysis, kind: str, folder: str | os.PathLike[str]) -> list[Path]:
    """Write `roundtrips` and `summary` as `kind` (a key of `EXPORTERS`) into a folder, and return the two files.

    Raises:
        OutputError: a file cannot be written.
    """
    frames = {"roundtrips": analysis.scan_roundtrips(), "summary": analysis.summary.lazy()}
    return [
        write_file(Path(folder) / f"{name}.{kind}", partial(EXPORTERS[kind], rows)) for name, rows in frames.items()
    ]


EXPORT_KINDS: dict[str, Callable[[Analysis, Path], list[Path]]] = {
    **{kind: lambda analysis, folder, kind=kind: export_tables(analysis, kind, folder) for kind in EXPORTERS},  # type: ignore[misc]
    **{kind: lambda analysis, folder, home=home: home()(analysis, folder) for kind, home in offers("exports").items()},  # type: ignore[misc]
}


def export(analysis: Analysis, kind: str, folder: str | os.PathLike[str]) -> list[Path]:
    """Write an export of a kind (a key of `EXPORT_KINDS`) into a folder, and return its files.

    Raises:
        OutputError: a file cannot be written.
        ModuleNotFoundError: the kind needs an extra that is not installed.
    """
    return EXPORT_KINDS[kind](analysis, Path(folder))
