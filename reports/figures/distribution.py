"""How the values of a group are spread: the tail on an axis of rarity, and the body as the share of messages in time.

The share is of the messages planned: one that was lost, or was due and never left, is infinitely late, and the curve ends
at the share received. That of the survivors, which came back, stands beside it. The tail is of the survivors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.numbers import any_curve
from .figure import Figure, LeftOut, Scope, figure_maker

if TYPE_CHECKING:
    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class DistributionCurves:
    """Whether any group has a curve. The page holds the curves once (`Curves`), for both figures."""

    any_drawn: bool


def distribution_info(book: Book) -> DistributionCurves:
    """Look for a group with two messages at least."""
    return DistributionCurves(any_curve(book.analysis))


def percentile_curve_figure(info: DistributionCurves) -> Figure | LeftOut:
    """Draw one curve per series of the chosen cell, over 1 / (1 - q) on a log axis."""
    name, title = "percentile_curve", "Percentile curve"
    if not info.any_drawn:
        return LeftOut(name, title, "no group has two messages that came back.")
    how_to_read = (
        "Each step to the right is ten times rarer: read off how late the worst message in 10, 100 or 1,000 of the survivors "
        "(the messages that came back) was; a curve ends where the sample does."
    )
    return Figure(name, title, how_to_read, "percentile_curve", {})


def ecdf_figure(info: DistributionCurves) -> Figure | LeftOut:
    """Draw one empirical distribution function per series of the chosen cell."""
    name, title = "ecdf", "Share of messages in time (ECDF)"
    if not info.any_drawn:
        return LeftOut(name, title, "no group has two messages that came back.")
    how_to_read = (
        "Pick a deadline on the horizontal axis: the curve says which share of the messages planned met it; as one that was lost, "
        "or was due and never left, never does, it ends at the share received, and where that is less than all the curve of the "
        "survivors (the messages that came back) stands beside."
    )
    return Figure(name, title, how_to_read, "ecdf", {})


PERCENTILE_CURVE = figure_maker(distribution_info, percentile_curve_figure, Scope.CELL)
ECDF = figure_maker(distribution_info, ecdf_figure, Scope.CELL)
