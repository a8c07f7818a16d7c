"""An analysis in a notebook, as the part `presenter`."""

from __future__ import annotations

import tempfile
import webbrowser
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.analyzer.analysis import Analysis
from dds_trace.base.units import counted
from dds_trace.extensions.gates.compare import Comparison
from dds_trace.extensions.gates.info import comparison_info
from dds_trace.extensions.gates.report import curve, result_table
from dds_trace.reports import blocks
from dds_trace.reports.blocks import MARKDOWN, Span, Table, Words
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.findings import severity_counts
from dds_trace.reports.book.sizes import HOW_TO_READ, size_block
from dds_trace.reports.reporters import load_reporter, write_reports

from .plotting import line_figure

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


MOST_CHARACTERS = 11_000
"""Longest first screen, which a notebook saves in its file."""

_BELOW = 700

# A red with a contrast of 4.5 on a light and a dark notebook.
_LOST = "color:#e5484d"
_SOFT = "font-size:90%"
_CELL = "text-align:left;white-space:nowrap"
_PENS = (
    "<style>.dds-trace path{fill:none;stroke:#888;stroke-width:2}.dds-trace .base{stroke:#2e90d4}.dds-trace .new{stroke:#e68246}"
    ".dds-trace .dashed{stroke-dasharray:5 3}.dds-trace text{fill:#888;font-size:11px}</style>"
)
_HOW_TO_READ_CHANGES = (
    f"<p style='{_SOFT}'>Each time is base → new, with the change and its interval. A verdict needs three runs a side, else: too few "
    "runs. In <code>rows</code> a ratio is new to base, and inconclusive means that neither a change nor equality is shown.</p>"
)
_TOO_LONG = "The table is too long for a cell of a notebook."


def first_screen(analysis: Analysis) -> str:
    book = Book(analysis)
    answer, sizes = book.answer, book.sizes
    counts = ", ".join(text for _, text in severity_counts(book.findings))
    above = [
        f"<p style='{_SOFT}'>Latency report: {escape(book.title)}</p>",
        *([f"<p><b>{escape(book.advice.sentence)}</b></p>"] if book.advice else []),
        f"<p><b>{escape(answer.headline)}</b></p>",
        "<ul>" + "".join(f"<li>{escape(point)}</li>" for point in answer.points) + "</ul>" if answer.points else "",
    ]
    further = f"Findings: {counts}. " if counts else ""
    below = f"<p style='{_SOFT}'>{further}The whole report: <code>show()</code>, its figures: <code>plot()</code>.</p>"
    top = "".join(above)
    if len(top) >= MOST_CHARACTERS // 2:  # strings of a trace may be long
        top = f"<p>{escape(top[: MOST_CHARACTERS // 4])} ...</p>"
    if sizes is not None:
        room = MOST_CHARACTERS - len(top) - len(below) - _BELOW
        pairs = ("more link", "more links")
        hidden = sum(len(site.further) for site in sizes.places)
        more = f"And {counted(hidden, 'more row')}, of another rate: <code>summary</code>. " if hidden else ""
        top += f"{_table(size_block(sizes), room, pairs)}<p style='{_SOFT}'>{more}{escape(HOW_TO_READ)}</p>"
    return f"<div>{top}{below}</div>"


def _table(table: Table, room: int, noun: tuple[str, str]) -> str:
    columns, rows = table.seen(MARKDOWN)
    caption = f"<caption style='{_CELL}'>{_html(table.caption)}</caption>" if table.caption else ""
    names = "".join(f"<th style='{_CELL}'>{escape(column.name)}</th>" for column in columns)
    start = f"<table>{caption}<thead><tr>{names}</tr></thead>"
    parts = table.parts(MARKDOWN)
    if not any(part for part, _ in parts):
        parts = [("", [row]) for row in rows]
    bodies: list[str] = []
    for part, own_rows in parts:
        head = f"<tr><th colspan='{len(columns)}' style='{_CELL}'>{escape(part)}</th></tr>" if part else ""
        body = f"<tbody>{head}{''.join(_row(cells) for _, cells in own_rows)}</tbody>"
        if len(start) + sum(map(len, bodies)) + len(body) > room:
            break
        bodies.append(body)
    remaining = len(parts) - len(bodies)
    more = f"<p style='{_SOFT}'>And {counted(remaining, *noun)}.</p>" if remaining else ""
    return f"{start}{''.join(bodies)}</table>{more}" if bodies else f"<p style='{_SOFT}'>{_TOO_LONG}</p>"


def _row(cells: Sequence[Words]) -> str:
    name, *others = map(_html, cells)
    columns = "".join(f"<td>{cell}</td>" for cell in others)
    return f"<tr style='{_CELL}'><th style='{_CELL}'>{name}</th>{columns}</tr>"


def _html(words: Words) -> str:
    if isinstance(words, (str, blocks.Figure)):
        return escape(blocks.plain_text(words))
    if isinstance(words, blocks.Stack):
        return "<br>".join(map(_html, words.lines))
    return "".join(map(_span, words))


def _span(span: Span) -> str:
    text, tones = escape(span.text), span.tone.split()
    if "bad" in tones and "verdict" not in tones:
        return f"<span style='{_LOST}'>{text}</span>"
    return f"<b>{text}</b>" if {"strong", "verdict"} & {*tones} else text


def comparison_screen(comparison: Comparison) -> str:
    info = comparison_info(comparison)
    top = f"<p><b>{escape(info.said)}</b> {escape(info.seen)}</p>"
    top += "".join(f"<p style='{_SOFT}'>{escape(note)}</p>" for note in info.notes)
    if len(top) >= MOST_CHARACTERS // 2:
        top = f"<p>{escape(info.said[: MOST_CHARACTERS // 8])} ...</p>"
    if not info.groups:
        return f"<div>{top}</div>"
    worst = info.groups[0]
    for row in worst.distributions[:1]:
        top += (
            f"<p>{escape(worst.label)}: base (dashed) and new side</p><div class='dds-trace'>{_PENS}{curve(row)}</div>"
        )
    top += _HOW_TO_READ_CHANGES
    table = result_table(info, None, None)
    return f"<div>{top}{_table(table, MOST_CHARACTERS - len(top) - _BELOW, ('more result', 'more results'))}</div>"


def markdown(report: blocks.Report) -> str:
    text: str = load_reporter("md").render(report)
    return text


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
