"""An analysis in a notebook: its first screen as HTML, its figures as plotly values, its whole report in the browser.

`analyzer.analysis.Presenter` names these functions; the analyzer finds this module by its name, as imports run one way.
"""

from __future__ import annotations

import tempfile
import webbrowser
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.units import counted

from .book.book import Book
from .book.findings import severity_counts
from .book.sizes import HOW_TO_READ
from .plotting import line_figure
from .reporters import write_reports

if TYPE_CHECKING:
    from collections.abc import Sequence

    from plotly.graph_objects import Figure

    from dds_trace.analyzer.analysis import Analysis

    from .book.sizes import PlaceRows, SizeCell, SizeTable

MOST_CHARACTERS = 12_000
"""Longest first screen: a notebook keeps it in its file at every run."""

_BELOW = 700
"""Characters that are kept for what stands below the table."""

# No colour but that of losses: the text takes the notebook's own, light or dark. This red has a contrast of 4.5 on both grounds.
_LOST = "color:#e5484d"
_SOFT = "font-size:90%"
_CELL = "text-align:left;white-space:nowrap"


def first_screen(analysis: Analysis) -> str:
    """Return headline, what follows from it and the table of sizes as HTML without a script, at most `MOST_CHARACTERS`."""
    book = Book(analysis)
    answer, sizes = book.answer, book.sizes
    counts = ", ".join(text for _, text in severity_counts(book.findings))
    above = [
        f"<p style='{_SOFT}'>Latency report: {escape(book.overview.title)}</p>",
        *([f"<p><b>{escape(book.advice.said)}</b></p>"] if book.advice else []),
        f"<p><b>{escape(answer.headline)}</b></p>",
        "<ul>" + "".join(f"<li>{escape(point)}</li>" for point in answer.points) + "</ul>"
        if answer.points
        else "",
    ]
    further = f"Findings: {counts}. " if counts else ""
    below = f"<p style='{_SOFT}'>{further}The whole report: <code>show()</code>, its figures: <code>plot()</code>.</p>"
    said = _cut("".join(above))
    table = "" if sizes is None else _table(sizes, MOST_CHARACTERS - len(said) - len(below) - _BELOW)
    return f"<div>{said}{table}{below}</div>"


def _cut(above: str) -> str:
    """Return what stands above the table, unless it alone is too long: strings of a trace may be."""
    return (
        above if len(above) < MOST_CHARACTERS // 2 else f"<p>{escape(above[: MOST_CHARACTERS // 4])} ...</p>"
    )


def _table(sizes: SizeTable, room: int) -> str:
    """Return as many places as there is room for, and count the others."""
    span = len(sizes.choices) + 1
    names = "".join(f"<th style='{_CELL}'>{escape(choice)}</th>" for choice in sizes.choices)
    start = (
        f"<table><caption style='{_CELL}'>Latency {escape(sizes.rates)}, median / p99</caption>"
        f"<thead><tr><th style='{_CELL}'>Size</th>{names}</tr></thead>"
    )
    bodies: list[str] = []
    for place in sizes.places:
        body = _place(place, sizes.deadline, span)
        if len(start) + sum(map(len, bodies)) + len(body) > room:
            break
        bodies.append(body)
    left = len(sizes.places) - len(bodies)
    more = (
        f" And {counted(left, 'more pair of devices and link', 'more pairs of devices and links')}."
        if left
        else ""
    )
    if not bodies:
        return f"<p style='{_SOFT}'>The table of sizes is too long for a cell of a notebook.</p>"
    return f"{start}{''.join(bodies)}</table><p style='{_SOFT}'>{escape(HOW_TO_READ)}{more}</p>"


def _place(place: PlaceRows, deadline: str, span: int) -> str:
    rows = [f"<tr><th colspan='{span}' style='{_CELL}'>{escape(place.place)}</th></tr>"]
    if place.thresholds:
        outcomes = [
            "" if one is None else f"<b>{escape(one.outcome)}</b> {escape(one.why)}"
            for one in place.thresholds
        ]
        rows.append(_row(deadline, outcomes))
    rows += [_row(row.size, [_cell(cell) for cell in row.cells]) for row in place.rows]
    return f"<tbody>{''.join(rows)}</tbody>"


def _row(name: str, cells: Sequence[str]) -> str:
    held = "".join(f"<td>{cell}</td>" for cell in cells)
    return f"<tr style='{_CELL}'><th style='{_CELL}'>{escape(name)}</th>{held}</tr>"


def _cell(cell: SizeCell | None) -> str:
    if cell is None:
        return ""
    times = " / ".join(
        f"<b>{escape(text)}</b>" if leads else escape(text)
        for text, leads in ((cell.p50, cell.leads_p50), (cell.p99, cell.leads_p99))
    )
    return f"{times} <span style='{_LOST}'>{escape(cell.lost)}</span>" if cell.lost else times


def plot(
    analysis: Analysis,
    name: str,
    *,
    panels: str | None = None,
    metric: str | None = None,
    statistic: str = "p50",
) -> Figure:
    """Return a figure of the page as a plotly value (`plotting.line_figure`)."""
    return line_figure(Book(analysis), name, panels, metric, statistic)


def show(analysis: Analysis, folder: Path | None = None) -> Path:
    """Write the HTML report, open it in the browser of this machine and return its path.

    Args:
        analysis: what to report.
        folder: where it goes; None for a new folder of the system's temporary ones, which is not removed.
    """
    where = Path(tempfile.mkdtemp(prefix="dds-trace-")) if folder is None else Path(folder)
    where.mkdir(parents=True, exist_ok=True)
    (path,) = write_reports(analysis, ["html"], where)
    assert path is not None
    webbrowser.open(path.resolve().as_uri())
    return path
