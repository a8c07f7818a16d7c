"""The JSON report, for scripts: everything that the page says, with `report.schema.json` as its contract."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from reports.answer import answer_info
from reports.overview import overview_info

if TYPE_CHECKING:
    from pathlib import Path

    from analyzer.analysis import Analysis

FILE_NAME = "report.json"
FORMAT_VERSION = 1
"""Version 1: first version (2026). A field may be added without a new version; none changes its meaning."""


def render(analysis: Analysis) -> str:
    """The report; strings are as the traces have them, every character beyond ASCII escaped."""
    return json.dumps(_finite(_document(analysis)), indent=1, allow_nan=False) + "\n"


def write(analysis: Analysis, folder: Path) -> Path:
    """Writes the report into `folder` and says where."""
    path = folder / FILE_NAME
    path.write_text(render(analysis), encoding="utf-8", newline="\n")
    return path


def schema() -> dict[str, Any]:
    """The JSON Schema (2020-12) that every report of this version follows."""
    found: dict[str, Any] = json.loads((files("reports") / "report.schema.json").read_text(encoding="utf-8"))
    return found


def _document(analysis: Analysis) -> dict[str, Any]:
    return {
        "format": FORMAT_VERSION,
        "title": analysis.title,
        "measured": [asdict(fact) for fact in overview_info(analysis).facts],
        "answer": asdict(answer_info(analysis)),
        "findings": [{**asdict(one), "severity": one.severity.value} for one in analysis.findings],
        "sources": [asdict(source) for source in analysis.sources],
        "sessions": [json.loads(session.to_json()) for session in analysis.sessions],
        "runs": [json.loads(run.to_json()) for run in analysis.runs],
        "groups": analysis.summary.to_dicts(),
    }


def _finite(value: Any) -> Any:
    """The value with null for NaN and infinity, which JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in value]
    return value
