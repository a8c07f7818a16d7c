"""A comparison as one HTML page in the report's style."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Mapping, Sequence
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from dds_trace.analyzer.verdicts.comparison_rows import DISTRIBUTION_LEVELS
from dds_trace.base.files import asset
from dds_trace.base.printable import printable
from dds_trace.base.units import format_duration

from ..book.verdicts import VERDICTS, received_words, runs_words
from .info import ComparedGroup, ComparisonInfo
from .words import (
    GATE_COLUMNS,
    both_words,
    change_words,
    gate_notes,
    gate_rows,
    interval_words,
    metric_words,
    statistic_cells,
    statistic_words,
    time_words,
    tone_of,
)

Row = Mapping[str, Any]


def render(info: ComparisonInfo, title: str) -> str:
    script = asset(__package__, "comparison.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    shown = info.groups[0].shown() if info.groups else ()
    return environment.from_string(asset(__package__, "comparison.html.j2")).render(
        policy=(
            f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; "
            "base-uri 'none'; form-action 'none'"
        ),
        style=Markup(asset("dds_trace.reports.html", "page.css") + asset(__package__, "comparison.css")),  # noqa: S704 - our own files
        script=Markup(script),  # noqa: S704 - our own file
        title=printable(title),
        info=info,
        shown_labels=[statistic_words(row["statistic"]) for row in shown],
        groups=[_group(group) for group in info.groups],
        gate_columns=GATE_COLUMNS,
        gates=[cells for _, cells in gate_rows(info.gates, shows_all=True)],
        gate_notes=gate_notes(info.gates),
    )


def _group(group: ComparedGroup) -> dict[str, object]:
    distribution = next((row for row in group.distributions if row["metric"] == group.changes[0]["metric"]), None)
    return {
        "label": group.label,
        "unlike": printable(group.unlike),
        "verdict": group.verdict,
        "where": group.where,
        "tone": tone_of(group.verdict),
        "received": received_words(group.delivery),
        "strip": "" if distribution is None else strip(distribution),
        "curves": [curve(row) for row in group.distributions],
        "shown": [(both_words(row), change_words(row["ratio"]), interval_words(row)) for row in group.shown()],
        "rows": [(*statistic_cells(row), runs_words(row), VERDICTS[row["verdict"]]) for row in group.changes],
    }


SIDES = ("base", "new")
STRIP_WIDTH, CURVE_WIDTH, CURVE_HEIGHT = 250, 330, 190
_MARGIN = 8


class _Scale:
    def __init__(self, row: Row, left: float, right: float) -> None:
        values = [value for side in SIDES for value in row[f"{side}_ns"] if 0 < value < math.inf]
        self.low_ns, self.high_ns = min(values, default=1.0), max(values, default=1.0)
        self._left, self._right = left, right

    def __call__(self, value_ns: float) -> float:
        if math.isinf(value_ns):
            return self._right
        if self.high_ns <= self.low_ns or value_ns <= 0:
            return self._left if value_ns < self.low_ns else (self._left + self._right) / 2
        share = math.log(value_ns / self.low_ns) / math.log(self.high_ns / self.low_ns)
        return self._left + share * (self._right - self._left)


def _levels(row: Row, side: str) -> dict[float, float]:
    return dict(zip(DISTRIBUTION_LEVELS, row[f"{side}_ns"], strict=False))


def strip(row: Row) -> Markup:
    scale = _Scale(row, _MARGIN, STRIP_WIDTH - _MARGIN)
    parts = []
    for side, y in zip(SIDES, (9, 23), strict=True):
        at = _levels(row, side)
        if not at:
            continue
        ends = at.get(0.01, min(at.values())), at.get(0.99, max(at.values()))
        parts.append(_path(f"{side} range", *((scale(end), y) for end in ends)))
        if 0.25 in at and 0.75 in at:
            parts.append(_path(f"{side} middle", (scale(at[0.25]), y), (scale(at[0.75]), y)))
        if 0.5 in at:
            x = scale(at[0.5])
            parts.append(_path("median", (x, y - 5), (x, y + 5)))
    return _svg("strip", STRIP_WIDTH, 46, [*parts, *_ends(scale, STRIP_WIDTH, 42)], _medians(row))


def curve(row: Row) -> Markup:
    left, bottom, top = 42, CURVE_HEIGHT - 24, 18
    scale = _Scale(row, left, CURVE_WIDTH - _MARGIN)

    def height(share: float) -> float:
        return bottom - share * (bottom - top)

    metric = metric_words(row["metric"])
    parts = [_text(f"{metric}, messages received within it", left, 12)]
    for share in (0, 0.5, 1):
        parts.append(_path("frame", (left, height(share)), (CURVE_WIDTH - _MARGIN, height(share))))
        parts.append(_text(f"{round(100 * share)} %", left - 4, round(height(share) + 4, 1), anchor="end"))
    for side in SIDES:
        times = _levels(row, side).items()
        points = [(scale(value), height(level)) for level, value in times if math.isfinite(value)]
        if points:
            parts.append(_path(f"{side} line{' dashed' if side == 'base' else ''}", *points))
    parts += _ends(scale, CURVE_WIDTH, CURVE_HEIGHT - 8, left)
    return _svg("curve", CURVE_WIDTH, CURVE_HEIGHT, parts, f"{metric}: {_medians(row)}")


def _medians(row: Row) -> str:
    base, new = (time_words(_levels(row, side).get(0.5)) for side in SIDES)
    return f"distributions of both sides, medians {base} and {new}"


def _ends(scale: _Scale, width: float, y: float, left: float = _MARGIN) -> list[Markup]:
    return [
        _text(format_duration(scale.low_ns), left, y),
        _text(format_duration(scale.high_ns), width - _MARGIN, y, anchor="end"),
    ]


def _text(text: str, x: float, y: float, anchor: str = "start") -> Markup:
    return Markup('<text x="{}" y="{}" text-anchor="{}">{}</text>').format(x, y, anchor, text)


def _path(name: str, *points: tuple[float, float]) -> Markup:
    steps = "L".join(f"{round(x, 1):g} {round(y, 1):g}" for x, y in points)
    return Markup('<path class="{}" d="M{}"/>').format(name, steps)


def _svg(name: str, width: int, height: int, parts: Sequence[Markup], words: str) -> Markup:
    return Markup(
        '<svg class="{}" width="{}" height="{}" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>'
    ).format(name, width, height, width, height, words, Markup().join(parts))
