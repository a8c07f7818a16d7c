"""The columns of the tables that an analysis writes, and the script that computes them by itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS

from .markdown import code, escaped, table

if TYPE_CHECKING:
    from collections.abc import Iterable

    from dds_trace.analyzer.model.metrics import Column


def roundtrips() -> str:
    """Return the columns of `roundtrips.parquet`."""
    return _columns(ROUNDTRIP_COLUMNS)


def summary() -> str:
    """Return the columns of `summary.parquet`."""
    return _columns(SUMMARY_COLUMNS)


def bare_analyzer() -> str:
    """Return the script with which the tests compare the analyzer."""
    script = Path(__file__).parents[2] / "tests" / "support" / "bare.py"
    return f"```python\n{script.read_text(encoding='utf-8')}```\n"


def _columns(columns: Iterable[Column]) -> str:
    rows = ([code(each.name), code(each.dtype), escaped(each.unit), escaped(each.meaning)] for each in columns)
    return table(("column", "type", "unit", "meaning"), rows)
