"""JSON report for scripts: everything on the page, under the contract of `report.schema.json`."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import polars as pl

from dds_trace.analyzer.analysis import DETAIL_FRAMES
from dds_trace.analyzer.saving.records import to_json
from dds_trace.base.files import write_whole

from .book.book import Book

FILE_NAME = "report.json"
FORMAT_VERSION = 1
"""A field may be added without a new version."""

_IDENTIFIERS = ("run_id", "session_id")
"""Columns written as hex digits: a JSON number has no 64 bits."""


def render(book: Book) -> str:
    parts = [f"{json.dumps(name)}: {_lines(value)}" for name, value in _document(book).items()]
    return "{\n" + ",\n".join(parts) + "\n}\n"


def write(book: Book, folder: Path) -> Path:
    return write_whole(folder / FILE_NAME, render(book))


def _document(book: Book) -> dict[str, object]:
    analysis = book.analysis
    details = analysis.details
    return {
        "format": FORMAT_VERSION,
        "title": analysis.title,
        "measured": book.overview.facts,
        "own_cost": book.own_costs,
        "answer": book.answer,
        "findings": analysis.findings,
        "sources": analysis.sources,
        "sessions": [json.loads(session.to_json()) for session in analysis.sessions],
        "runs": [json.loads(run.to_json()) for run in analysis.runs],
        "groups": analysis.summary,
        "topics": analysis.topics,
        "topic_hops": analysis.topic_hops,
        **{name: getattr(details, name) if details.requested else None for name in DETAIL_FRAMES},
        "judgements": analysis.judgements if details.requested else None,
        "answers": details.answers if details.requested else None,
        "deadline_ns": details.deadline_ns,
        "deadline_metric": details.deadline_metric,
        "recommendation": details.recommendation,
    }


def _lines(value: object) -> str:
    if isinstance(value, pl.DataFrame):
        lines = _rows(value)
    elif isinstance(value, (list, tuple)):
        lines = [_text(element) for element in value]
    else:
        return _text(value)
    return "[\n" + ",\n".join(lines) + "\n]" if lines else "[]"


def _rows(frame: pl.DataFrame) -> list[str]:
    template = ", ".join(f"{json.dumps(name)}: %s" for name in frame.columns)
    return ["{" + template % values + "}" for values in zip(*map(_column, frame), strict=True)]


def _column(series: pl.Series) -> list[str]:
    values = series.to_list()
    if series.name in _IDENTIFIERS:
        return [f'"{value:016x}"' for value in values]
    if series.dtype.is_numeric() or series.dtype == pl.Boolean:
        with suppress(ValueError):  # not finite
            return json.dumps(values, allow_nan=False)[1:-1].split(", ") if values else []
    if series.dtype not in (pl.String, pl.Null):
        return [_text(value) for value in values]
    texts = {value: _text(value) for value in set(values)}
    return [texts[value] for value in values]


def _text(value: object) -> str:
    with suppress(TypeError, ValueError):  # nearly all values are plain JSON
        return json.dumps(value, allow_nan=False)
    return json.dumps(to_json(value, not_finite=lambda _: None), allow_nan=False)
