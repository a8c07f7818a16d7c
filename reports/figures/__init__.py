"""Figures of a report, in the order in which it shows them; each `*_info` then `*_figure`."""

from __future__ import annotations

from . import (
    breakdown,
    bridge_cost,
    capacity,
    clocks,
    comparison,
    distribution,
    first_message,
    host_load,
    latency,
    sent_again,
    timeline,
    wire_cost,
)
from .figure import Figure, FigureMaker, LeftOut, Scope, figure_maker

FIGURES: list[FigureMaker] = [
    comparison.VENDOR_COMPARISON,
    latency.LATENCY_BY_RATE,
    latency.LATENCY_BY_SIZE,
    comparison.DOMAIN_DIFFERENCE,
    bridge_cost.FIGURE,
    latency.HEATMAP,
    capacity.RECEIVED,
    capacity.TRANSFER_RATE,
    capacity.SUSTAINABLE,
    breakdown.FIGURE,
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

__all__ = ["FIGURES", "Figure", "FigureMaker", "LeftOut", "Scope", "figure_maker"]
