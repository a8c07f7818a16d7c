"""The table of reporters: one module each, with the same two doors `render` and `write`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from dds_trace.tracefile.errors import OptionError, OutputError

from . import document, markdown, terminal
from .html import page

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from dds_trace.analyzer.analysis import Analysis


class Reporter(Protocol):
    """What a reporter's module offers."""

    def render(self, analysis: Analysis) -> str:
        """The report as text; equal input gives equal text."""

    def write(self, analysis: Analysis, folder: Path) -> Path | None:
        """Writes the report below `folder` and gives its path, or prints it and gives None."""


REPORTERS: Mapping[str, Reporter] = {"html": page, "md": markdown, "json": document, "terminal": terminal}
"""Kind of report, as `--report` takes it -> its reporter."""


def write_report(analysis: Analysis, kind: str, folder: Path) -> Path | None:
    """Writes one report of an analysis.

    Args:
        analysis: what to report.
        kind: a key of `REPORTERS`.
        folder: where files go; it must exist.

    Returns:
        The file, or None for a report that was printed to stdout.

    Raises:
        OptionError: there is no such kind.
        OutputError: the file cannot be written.
    """
    if kind not in REPORTERS:
        raise OptionError(f"no report of kind {kind!r}; choose from {', '.join(REPORTERS)}")
    try:
        return REPORTERS[kind].write(analysis, folder)
    except OSError as err:
        raise OutputError(
            f"{folder}: cannot write the {kind} report ({err.strerror}); check the folder"
        ) from err
