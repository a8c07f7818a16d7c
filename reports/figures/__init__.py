"""Figures of a report, in the order in which it shows them; each `*_info` then `*_figure`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import (
    breakdown,
    bridge_cost,
    capacity,
    clocks,
    comparison,
    distribution,
    dots,
    first_message,
    host_load,
    latency,
    sent_again,
    timeline,
    wire_cost,
)
from .figure import Figure, FigureMaker, LeftOut, Scope, figure_maker, is_few

if TYPE_CHECKING:
    from ..book.book import Book

FIGURES: list[FigureMaker] = [
    dots.FIGURE,
    latency.LATENCY_BY_RATE,
    latency.LATENCY_BY_SIZE,
    comparison.DOMAIN_DIFFERENCE,
    bridge_cost.FIGURE,
    capacity.RECEIVED,
    breakdown.FIGURE,
    comparison.VENDOR_COMPARISON,
    comparison.BY_DEVICE,
    latency.HEATMAP,
    latency.RELAY_TIME,
    distribution.RUN_SPREAD,
    capacity.SUSTAINABLE,
    capacity.TRANSFER_BY_RATE,
    capacity.TRANSFER_BY_SIZE,
    capacity.TRANSFER_RATE,
    wire_cost.FIGURE,
    sent_again.FIGURE,
    first_message.FIGURE,
    clocks.ONE_WAY,
    clocks.CLOCK,
    distribution.PERCENTILE_CURVE,
    distribution.ECDF,
    timeline.FIGURE,
    host_load.FIGURE,
]
"""The table of figures: one row each."""


def drawn_figures(book: Book) -> list[tuple[FigureMaker, Figure | LeftOut]]:
    """Draw every figure of the table; of a few groups the chart of dots stands in for those that need more."""
    few = is_few(book)
    made = []
    for maker in FIGURES:
        if maker is dots.FIGURE and not few:
            continue
        drawn = maker.draw(book)
        if few and not maker.few and isinstance(drawn, Figure):
            drawn = LeftOut(drawn.name, drawn.title, "so few groups are in the first figure, all in one.")
        made.append((maker, drawn))
    return made


__all__ = ["FIGURES", "Figure", "FigureMaker", "LeftOut", "Scope", "drawn_figures", "figure_maker"]
