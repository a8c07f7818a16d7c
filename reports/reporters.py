"""The table of report formats: one module each that draws any `blocks.Report`."""

from __future__ import annotations

import os
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from dds_trace.base.errors import OptionError, OutputError
from dds_trace.base.files import write_whole

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

    from .blocks import Report

REPORT_MODULES = {
    "html": "dds_trace.reports.html.page",
    "md": "dds_trace.reports.markdown",
    "json": "dds_trace.reports.document",
    "terminal": "dds_trace.reports.terminal",
}
"""Kind, which is also the ending of its file, and module; a terminal's is printed."""


class Reporter(Protocol):
    """A module of a report format."""

    def render(self, report: Report) -> str:
        """Return the report as text; equal input gives equal text."""


def load_reporter(kind: str) -> Reporter:
    """Return the reporter of one kind; an `OptionError` if there is no such kind."""
    if kind not in REPORT_MODULES:
        raise OptionError(f"no report of kind {kind!r}; choose from {', '.join(REPORT_MODULES)}")
    reporter: Reporter = import_module(REPORT_MODULES[kind])
    return reporter


def write_reports(
    analysis: Analysis, kinds: Iterable[str], folder: str | os.PathLike[str], *, shows_all: bool = False
) -> list[Path | None]:
    """Write reports of one analysis into a folder, which must exist; the terminal's has tables only if it `shows_all`.

    Returns:
        The file of each kind, None for a printed report.

    Raises:
        OptionError: there is no such kind.
        OutputError: a file cannot be written.
    """
    from .book.book import Book  # noqa: PLC0415 - the names of the kinds are read without polars

    reporters = {kind: load_reporter(kind) for kind in kinds}
    book = Book(analysis, shows_all=shows_all)
    return [_write(reporter, book, kind, Path(folder)) for kind, reporter in reporters.items()]


def _write(reporter: Reporter, report: Report, kind: str, folder: Path) -> Path | None:
    if kind == "terminal":
        from .terminal import print_report  # noqa: PLC0415 - as above

        print_report(report)
        return None
    try:
        return write_whole(folder / f"{report.name}.{kind}", reporter.render(report))
    except OSError as err:
        raise OutputError(f"{folder}: cannot write the {kind} report ({err.strerror}); check the folder") from err
