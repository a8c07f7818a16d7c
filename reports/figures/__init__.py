"""Figures of a report, in the order in which it shows them; each `*_info` then `*_figure`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import (
    breakdown,
    bridge_cost,
    clocks,
    distribution,
    domain_difference,
    dots,
    heatmap,
    host_load,
    lines,
    timeline,
    wire,
)
from .figure import Figure, FigureMaker, LeftOut, LineFigure, is_few

if TYPE_CHECKING:
    from ..book.book import Book

FIGURES: list[FigureMaker | LineFigure] = [
    dots.FIGURE,
    lines.LATENCY_BY_RATE,
    lines.LATENCY_BY_SIZE,
    domain_difference.FIGURE,
    bridge_cost.FIGURE,
    lines.RECEIVED,
    breakdown.FIGURE,
    lines.VENDOR_COMPARISON,
    lines.BY_DEVICE,
    heatmap.FIGURE,
    lines.RELAY_TIME,
    distribution.RUN_SPREAD,
    lines.SUSTAINABLE,
    lines.TRANSFER_BY_RATE,
    lines.TRANSFER_BY_SIZE,
    lines.TRANSFER_RATE,
    wire.WIRE_COST,
    wire.SENT_AGAIN,
    wire.FIRST_MESSAGE,
    clocks.ONE_WAY,
    clocks.CLOCK,
    distribution.PERCENTILE_CURVE,
    distribution.ECDF,
    timeline.FIGURE,
    host_load.FIGURE,
]


def drawn_figures(book: Book) -> list[tuple[FigureMaker | LineFigure, Figure | LeftOut]]:
    """Draw every figure; for a few groups the chart of dots replaces those that need more."""
    few = is_few(book)
    made = []
    for maker in FIGURES:
        if maker is dots.FIGURE and not few:
            continue
        drawn = maker.draw(book)
        if few and not maker.few and isinstance(drawn, Figure):
            drawn = LeftOut(drawn.name, drawn.title, "so few results are in the first figure, all in one.")
        made.append((maker, drawn))
    return made
