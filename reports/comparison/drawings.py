"""Distributions of both sides as SVG: a strip for the row of a group, and the share of messages below each time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from dds_trace.analyzer.verdicts.comparison_rows import DISTRIBUTION_LEVELS
from dds_trace.base.units import format_duration

from ..book.groups import METRIC_LABELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SIDES = ("base", "new")
STRIP_WIDTH, CURVE_WIDTH, CURVE_HEIGHT = 250, 330, 190
_MARGIN = 8


class _Scale:
    """A log axis from the shortest to the longest time of both sides."""

    def __init__(self, row: Mapping[str, Any], left: float, right: float) -> None:
        known = [value for side in SIDES for value in row[f"{side}_ns"] if 0 < value < math.inf]
        self.low_ns, self.high_ns = min(known, default=1.0), max(known, default=1.0)
        self._left, self._right = left, right

    def __call__(self, value_ns: float) -> float:
        """Return the place of a time; of one that was lost the right end."""
        if math.isinf(value_ns):
            return self._right
        if self.high_ns <= self.low_ns or value_ns <= 0:
            return self._left if value_ns < self.low_ns else (self._left + self._right) / 2
        share = math.log(value_ns / self.low_ns) / math.log(self.high_ns / self.low_ns)
        return self._left + share * (self._right - self._left)


def strip(row: Mapping[str, Any]) -> Markup:
    """Draw a range, the middle half and the median of each side, one above the other.

    Args:
        row: a row of `Comparison.distributions`.
    """
    place = _Scale(row, _MARGIN, STRIP_WIDTH - _MARGIN)
    drawn = []
    for side, y in zip(SIDES, (9, 23), strict=True):
        at = dict(zip(DISTRIBUTION_LEVELS, row[f"{side}_ns"], strict=False))
        if not at:
            continue
        ends = at.get(0.01, min(at.values())), at.get(0.99, max(at.values()))
        drawn.append(_path(f"{side} range", (place(ends[0]), y), (place(ends[1]), y)))
        if 0.25 in at and 0.75 in at:
            drawn.append(_path(f"{side} middle", (place(at[0.25]), y), (place(at[0.75]), y)))
        if 0.5 in at:
            x = place(at[0.5])
            drawn.append(_path("median", (x, y - 5), (x, y + 5)))
    return _svg("strip", STRIP_WIDTH, 46, [*drawn, *_ends(place, STRIP_WIDTH, 42)], _words(row))


def curve(row: Mapping[str, Any]) -> Markup:
    """Draw the share of messages sent that came back within each time; what was lost keeps a line below 100 %.

    Args:
        row: a row of `Comparison.distributions`.
    """
    left, bottom = 42, CURVE_HEIGHT - 24
    place = _Scale(row, left, CURVE_WIDTH - _MARGIN)
    top = 18

    def height(share: float) -> float:
        return bottom - share * (bottom - top)

    drawn = [
        _path("frame", (left, height(share)), (CURVE_WIDTH - _MARGIN, height(share))) for share in (0, 0.5, 1)
    ]
    for side in SIDES:
        points = [
            (place(value), height(level))
            for level, value in zip(DISTRIBUTION_LEVELS, row[f"{side}_ns"], strict=False)
            if math.isfinite(value)
        ]
        if points:
            drawn.append(_path(f"{side} line{' dashed' if side == 'base' else ''}", *points))
    metric = METRIC_LABELS.get(row["metric"], row["metric"])
    texts = [
        Markup('<text x="{}" y="12">{}, messages that came back within it</text>').format(left, metric),
        *(
            Markup('<text x="{}" y="{}" text-anchor="end">{} %</text>').format(
                left - 4, round(height(share) + 4, 1), round(100 * share)
            )
            for share in (0, 0.5, 1)
        ),
    ]
    return _svg(
        "curve",
        CURVE_WIDTH,
        CURVE_HEIGHT,
        [*drawn, *texts, *_ends(place, CURVE_WIDTH, CURVE_HEIGHT - 8, left)],
        f"{metric}: {_words(row)}",
    )


def _words(row: Mapping[str, Any]) -> str:
    """Say what a drawing shows to those who do not see it; the table beside it holds the numbers."""
    medians = (dict(zip(DISTRIBUTION_LEVELS, row[f"{side}_ns"], strict=False)).get(0.5) for side in SIDES)
    base, new = (
        "lost" if value is not None and math.isinf(value) else format_duration(value) for value in medians
    )
    return f"distributions of both sides, medians {base} and {new}"


def _ends(place: _Scale, width: float, y: float, left: float = _MARGIN) -> list[Markup]:
    if place.high_ns <= 0:
        return []
    return [
        Markup('<text x="{}" y="{}">{}</text>').format(left, y, format_duration(place.low_ns)),
        Markup('<text x="{}" y="{}" text-anchor="end">{}</text>').format(
            width - _MARGIN, y, format_duration(place.high_ns)
        ),
    ]


def _path(name: str, *points: tuple[float, float]) -> Markup:
    steps = "L".join(f"{round(x, 1):g} {round(y, 1):g}" for x, y in points)
    return Markup('<path class="{}" d="M{}"/>').format(name, steps)


def _svg(name: str, width: int, height: int, parts: Sequence[Markup], words: str) -> Markup:
    return Markup(
        '<svg class="{}" width="{}" height="{}" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>'
    ).format(name, width, height, width, height, words, Markup().join(parts))
