"""The Markdown report: short enough for a pull request, every string of a trace inert."""

from __future__ import annotations

from typing import TYPE_CHECKING

from reports.answer import answer_info
from reports.groups import METRICS, STATISTICS, data_type_label, groups_info
from reports.overview import findings_by_code, overview_info
from reports.text import format_hz, format_ns, format_ratio, format_size, markdown
from reports.values import values_info

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from analyzer.analysis import Analysis

FILE_NAME = "report.md"
MOST_GROUPS = 60
"""A comment on a pull request is read, not searched; the other groups are in `summary.parquet`."""
SHOWN_STATISTICS = ("p50", "p90", "p99", "max")


def render(analysis: Analysis) -> str:
    """The report as GitHub-flavoured Markdown."""
    overview, answer = overview_info(analysis), answer_info(analysis)
    parts = [
        f"# Latency report: {markdown(overview.title)}",
        f"**{markdown(answer.headline)}**",
        _table(
            ("Data", "Which is clearly fastest"),
            ((verdict.data, verdict.sentence) for verdict in answer.verdicts),
        ),
        _list(markdown(remark) for remark in answer.remarks),
        markdown(answer.rule),
        "## What was measured",
        _list(f"{markdown(fact.label)}: {markdown(fact.value)}" for fact in overview.facts),
        "## Findings",
        _findings(analysis),
        "## Groups",
        _groups(analysis),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def write(analysis: Analysis, folder: Path) -> Path:
    """Writes the report into `folder` and says where."""
    path = folder / FILE_NAME
    path.write_text(render(analysis), encoding="utf-8", newline="\n")
    return path


def _findings(analysis: Analysis) -> str:
    if not analysis.findings:
        return "Nothing doubtful was found."
    rows = []
    for first, *more in findings_by_code(analysis):
        where = f"{first.where} (and {len(more)} more)" if more else first.where
        rows.append((first.severity.value, where, first.what, first.action))
    return _table(("Severity", "Where", "What", "What to do"), rows)


def _groups(analysis: Analysis) -> str:
    groups, values = groups_info(analysis), values_info(analysis)
    if not groups.groups:
        return "No measurement was found."
    metric = values.default_metric
    rows = []
    for group in sorted(groups.groups, key=lambda group: (group.cell, group.series))[:MOST_GROUPS]:
        cell = groups.cell_of(group)
        rows.append(
            (
                data_type_label(cell.data_type),
                format_size(cell.payload_bytes),
                format_hz(cell.rate_hz),
                groups.labels[group.series],
                format_ratio(values.plain["received_ratio"][group.index]),
                *(format_ns(values.times_ns[metric][name][group.index]) for name in SHOWN_STATISTICS),
            )
        )
    names = (f"{METRICS[metric]} {STATISTICS[name]}" for name in SHOWN_STATISTICS)
    table = _table(("Data", "Size", "Rate", "Series", "Received", *names), rows)
    left = len(groups.groups) - len(rows)
    return f"{table}\n\n{left} more groups are in `summary.parquet`." if left else table


def _table(columns: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(markdown(cell) for cell in row)} |" for row in rows]
    if not lines:
        return ""
    return "\n".join([f"| {' | '.join(columns)} |", f"|{' --- |' * len(columns)}", *lines])


def _list(items: Iterable[str]) -> str:
    return "\n".join(f"- {item}" for item in items)
