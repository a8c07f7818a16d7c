"""An analysis in a notebook; `analyzer.model.presenter` loads this module by its name."""

from __future__ import annotations

import tempfile
import webbrowser
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.units import counted

from . import blocks
from .blocks import MARKDOWN, Span, Words
from .book.book import Book
from .book.findings import severity_counts
from .book.sizes import HOW_TO_READ, SizeTable, size_rows
from .comparison.info import comparison_info
from .comparison.report import result_table
from .plotting import line_figure
from .reporters import write_reports

if TYPE_CHECKING:
    from collections.abc import Sequence

    from plotly.graph_objects import Figure

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.analyzer.verdicts.compare import Comparison


MOST_CHARACTERS = 11_000
"""Longest first screen, which a notebook saves in its file."""

_BELOW = 700

# A red with a contrast of 4.5 on a light and a dark notebook.
_LOST = "color:#e5484d"
_SOFT = "font-size:90%"
_CELL = "text-align:left;white-space:nowrap"


def first_screen(analysis: Analysis) -> str:
    book = Book(analysis)
    answer, sizes = book.answer, book.sizes
    counts = ", ".join(text for _, text in severity_counts(book.findings))
    above = [
        f"<p style='{_SOFT}'>Latency report: {escape(book.overview.title)}</p>",
        *([f"<p><b>{escape(book.advice.sentence)}</b></p>"] if book.advice else []),
        f"<p><b>{escape(answer.headline)}</b></p>",
        "<ul>" + "".join(f"<li>{escape(point)}</li>" for point in answer.points) + "</ul>" if answer.points else "",
    ]
    further = f"Findings: {counts}. " if counts else ""
    below = f"<p style='{_SOFT}'>{further}The whole report: <code>show()</code>, its figures: <code>plot()</code>.</p>"
    top = "".join(above)
    if len(top) >= MOST_CHARACTERS // 2:  # strings of a trace may be long
        top = f"<p>{escape(top[: MOST_CHARACTERS // 4])} ...</p>"
    table = "" if sizes is None else _table(sizes, MOST_CHARACTERS - len(top) - len(below) - _BELOW)
    return f"<div>{top}{table}{below}</div>"


def _table(sizes: SizeTable, room: int) -> str:
    span = len(sizes.choices) + 1
    names = "".join(f"<th style='{_CELL}'>{escape(choice)}</th>" for choice in sizes.choices)
    start = (
        f"<table><caption style='{_CELL}'>{escape(sizes.caption)}</caption>"
        f"<thead><tr><th style='{_CELL}'>Size</th>{names}</tr></thead>"
    )
    bodies: list[str] = []
    for rows in sizes.places:
        lines = [f"<tr><th colspan='{span}' style='{_CELL}'>{escape(rows.place)}</th></tr>"]
        lines += [_row(row.cells) for row in size_rows(sizes, rows, separator="")]
        body = f"<tbody>{''.join(lines)}</tbody>"
        if len(start) + sum(map(len, bodies)) + len(body) > room:
            break
        bodies.append(body)
    remaining = len(sizes.places) - len(bodies)
    more = (
        f" And {counted(remaining, 'more pair of devices and link', 'more pairs of devices and links')}."
        if remaining
        else ""
    )
    if not bodies:
        return f"<p style='{_SOFT}'>The table of sizes is too long for a cell of a notebook.</p>"
    return f"{start}{''.join(bodies)}</table><p style='{_SOFT}'>{escape(HOW_TO_READ)}{more}</p>"


def _row(cells: Sequence[Words]) -> str:
    name, *others = map(_html, cells)
    columns = "".join(f"<td>{cell}</td>" for cell in others)
    return f"<tr style='{_CELL}'><th style='{_CELL}'>{name}</th>{columns}</tr>"


def _html(words: Words) -> str:
    if isinstance(words, (str, blocks.Figure)):
        return escape(blocks.plain_text(words))
    spans = words.spans if isinstance(words, blocks.Stack) else words
    return ("<br>" if isinstance(words, blocks.Stack) else "").join(map(_span, spans))


def _span(span: Span) -> str:
    text = escape(span.text)
    if span.tone == "bad":
        return f" <span style='{_LOST}'>{text}</span>"
    return f"<b>{text}</b>" if span.tone == "strong" or span.tone.startswith("verdict") else text


def comparison_screen(comparison: Comparison) -> str:
    info = comparison_info(comparison)
    top = f"<p><b>{escape(info.said)}</b> {escape(info.seen)}</p>"
    top += "".join(f"<p style='{_SOFT}'>{escape(note)}</p>" for note in info.notes)
    if len(top) >= MOST_CHARACTERS // 2:
        top = f"<p>{escape(info.said[: MOST_CHARACTERS // 8])} ...</p>"
    if not info.groups:
        return f"<div>{top}</div>"
    columns, cells = result_table(info, len(info.groups)).seen(MARKDOWN)
    names = "".join(f"<th style='{_CELL}'>{escape(column.name)}</th>" for column in columns)
    rows: list[str] = []
    room = MOST_CHARACTERS - len(top) - len(names) - _BELOW
    for _, texts in cells:
        rows.append(_row(texts))
        if sum(map(len, rows)) > room:
            rows.pop()
            break
    remaining = len(info.groups) - len(rows)
    more = f"<p style='{_SOFT}'>And {counted(remaining, 'more result')}.</p>" if remaining else ""
    return f"<div>{top}<table><thead><tr>{names}</tr></thead><tbody>{''.join(rows)}</tbody></table>{more}</div>"


def plot(
    analysis: Analysis, name: str, *, panels: str | None = None, metric: str | None = None, statistic: str = "p50"
) -> Figure:
    return line_figure(Book(analysis), name, panels, metric, statistic)


def show(analysis: Analysis, folder: Path | None = None) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="dds-trace-")) if folder is None else Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (path,) = write_reports(analysis, ["html"], folder)
    assert path is not None
    webbrowser.open(path.resolve().as_uri())
    return path
