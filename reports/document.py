"""The JSON report of whatever has a document, under the contract of its schema."""

from __future__ import annotations

import json
from contextlib import suppress

import polars as pl

from dds_trace.base.records import to_json

from .blocks import Report

_IDENTIFIERS = ("run_id", "session_id")
"""Columns written as hex digits: a JSON number has no 64 bits."""


def render(report: Report) -> str:
    parts = [f"{json.dumps(name)}: {_lines(value)}" for name, value in report.document.items()]
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _lines(value: object) -> str:
    if isinstance(value, pl.DataFrame):
        template = ", ".join(f"{json.dumps(name)}: %s" for name in value.columns)
        lines = ["{" + template % values + "}" for values in zip(*map(_column, value), strict=True)]
    elif isinstance(value, (list, tuple)):
        lines = [_text(element) for element in value]
    else:
        return _text(value)
    return "[\n" + ",\n".join(lines) + "\n]" if lines else "[]"


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
