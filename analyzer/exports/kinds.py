"""Kinds of `--export`, each with the function that writes it into a folder."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from polars.exceptions import PolarsError

from dds_trace.base.errors import OutputError
from dds_trace.base.files import replacing

from . import hdr_log, openmetrics, perfetto
from .tables import EXPORTERS, export_tables

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping

    from ..analysis import Analysis


def export(analysis: Analysis, kind: str, folder: str | os.PathLike[str]) -> list[Path]:
    """Write an export of a kind (a key of `EXPORT_KINDS`) into a folder, and return its files.

    Raises:
        OutputError: a file cannot be written.
        ModuleNotFoundError: the kind needs an extra that is not installed.
    """
    return EXPORT_KINDS[kind](analysis, folder)


def _one_file(
    name: str, write: Callable[[Analysis, Path], object], analysis: Analysis, folder: str | os.PathLike[str]
) -> list[Path]:
    path = Path(folder) / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft:
            write(analysis, draft)
    except (OSError, PolarsError) as err:
        raise OutputError(f"{path} cannot be written ({err}); give another folder with --out") from err
    return [path]


def _text(make: Callable[[Analysis], str], analysis: Analysis, path: Path) -> None:
    path.write_text(make(analysis), encoding="utf-8", newline="\n")


EXPORT_KINDS: Mapping[str, Callable[[Analysis, str | os.PathLike[str]], list[Path]]] = {
    **{kind: partial(lambda kind, analysis, folder: export_tables(analysis, kind, folder), kind) for kind in EXPORTERS},
    "openmetrics": partial(_one_file, openmetrics.FILE_NAME, partial(_text, openmetrics.openmetrics_text)),
    "hdr": partial(_one_file, hdr_log.FILE_NAME, partial(_text, hdr_log.hdr_log)),
    "perfetto": partial(_one_file, perfetto.FILE_NAME, perfetto.write_perfetto),
}
