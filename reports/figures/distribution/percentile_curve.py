"""The tail of each distribution, on a logarithmic axis of rarity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...book.curves import any_curve
from ..figure import Figure, LeftOut

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

NAME = "percentile_curve"
TITLE = "Percentile curve"
HOW_TO_READ = (
    "Each step to the right is ten times rarer: read off how late the worst message in 10, 100 or 1,000 was; "
    "a curve ends where the sample does."
)


@dataclass(frozen=True, slots=True)
class PercentileCurve:
    """Whether there are curves; the curves themselves are in the page once (`Curves`), for this figure and the ECDF."""

    any_drawn: bool


def percentile_curve_info(analysis: Analysis) -> PercentileCurve:
    """Looks for a group with two messages at least."""
    return PercentileCurve(any_curve(analysis))


def percentile_curve_figure(info: PercentileCurve) -> Figure | LeftOut:
    """One curve per series of the chosen cell."""
    if not info.any_drawn:
        return LeftOut(NAME, TITLE, "no group has two messages that came back.")
    return Figure(NAME, TITLE, HOW_TO_READ, "percentile_curve", {})
