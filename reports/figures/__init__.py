"""Figures of a report, in the order in which it shows them; each `*_info` then `*_figure`."""

from __future__ import annotations

from . import (
    breakdown,
    bridge_cost,
    capacity,
    clocks,
    comparison,
    distribution,
    host_load,
    latency,
    timeline,
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
    clocks.ONE_WAY,
    clocks.CLOCK,
    distribution.PERCENTILE_CURVE,
    distribution.ECDF,
    timeline.FIGURE,
    host_load.FIGURE,
]
"""The table of figures: one row each."""

__all__ = ["FIGURES", "Figure", "FigureMaker", "LeftOut", "Scope", "figure_maker"]
