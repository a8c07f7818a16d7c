"""Figures of a report, in the order in which it shows them; each `*_info` then `*_figure`."""

from __future__ import annotations

from . import (
    breakdown,
    bridge_cost,
    capacity,
    clock,
    distribution,
    domain_difference,
    heatmap,
    host_load,
    latency,
    one_way,
    timeline,
    vendor_comparison,
)
from .figure import Figure, FigureMaker, LeftOut, Scope, figure_maker

FIGURES: list[FigureMaker] = [
    vendor_comparison.FIGURE,
    latency.LATENCY_BY_RATE,
    latency.LATENCY_BY_SIZE,
    domain_difference.FIGURE,
    bridge_cost.FIGURE,
    heatmap.FIGURE,
    capacity.RECEIVED,
    capacity.TRANSFER_RATE,
    capacity.SUSTAINABLE,
    breakdown.FIGURE,
    one_way.FIGURE,
    clock.FIGURE,
    distribution.PERCENTILE_CURVE,
    distribution.ECDF,
    timeline.FIGURE,
    host_load.FIGURE,
]
"""The table of figures: one row each."""

__all__ = ["FIGURES", "Figure", "FigureMaker", "LeftOut", "Scope", "figure_maker"]
