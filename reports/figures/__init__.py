"""The figures of a report in the order in which it shows them; each `*_info` then `*_figure`, one per file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .comparison.bridge_cost import bridge_cost_figure, bridge_cost_info
from .comparison.domain_difference import (
    domain_difference_figure,
    domain_difference_info,
)
from .comparison.vendor_comparison import (
    vendor_comparison_figure,
    vendor_comparison_info,
)
from .distribution.breakdown import breakdown_figure, breakdown_info
from .distribution.ecdf import ecdf_figure, ecdf_info
from .distribution.percentile_curve import (
    percentile_curve_figure,
    percentile_curve_info,
)
from .figure import Figure, LeftOut
from .over_time.clock import clock_figure, clock_info
from .over_time.host_load import host_load_figure, host_load_info
from .over_time.one_way import one_way_figure, one_way_info
from .over_time.timeline import timeline_figure, timeline_info
from .scaling.heatmap import heatmap_figure, heatmap_info
from .scaling.latency_by_rate import latency_by_rate_figure, latency_by_rate_info
from .scaling.latency_by_size import latency_by_size_figure, latency_by_size_info
from .scaling.received import received_figure, received_info
from .scaling.sustainable import sustainable_figure, sustainable_info
from .scaling.transfer_rate import transfer_rate_figure, transfer_rate_info

if TYPE_CHECKING:
    from collections.abc import Callable

    from dds_trace.analyzer.analysis import Analysis

__all__ = ["CAMPAIGN_FIGURES", "CELL_FIGURES", "Figure", "LeftOut"]

CAMPAIGN_FIGURES: tuple[Callable[[Analysis], Figure | LeftOut], ...] = (
    lambda analysis: vendor_comparison_figure(vendor_comparison_info(analysis)),
    lambda analysis: latency_by_rate_figure(latency_by_rate_info(analysis)),
    lambda analysis: latency_by_size_figure(latency_by_size_info(analysis)),
    lambda analysis: domain_difference_figure(domain_difference_info(analysis)),
    lambda analysis: bridge_cost_figure(bridge_cost_info(analysis)),
    lambda analysis: heatmap_figure(heatmap_info(analysis)),
    lambda analysis: received_figure(received_info(analysis)),
    lambda analysis: transfer_rate_figure(transfer_rate_info(analysis)),
    lambda analysis: sustainable_figure(sustainable_info(analysis)),
    lambda analysis: breakdown_figure(breakdown_info(analysis)),
    lambda analysis: one_way_figure(one_way_info(analysis)),
    lambda analysis: clock_figure(clock_info(analysis)),
)
"""Figures of everything that passes the page's filters."""

CELL_FIGURES: tuple[Callable[[Analysis], Figure | LeftOut], ...] = (
    lambda analysis: percentile_curve_figure(percentile_curve_info(analysis)),
    lambda analysis: ecdf_figure(ecdf_info(analysis)),
    lambda analysis: timeline_figure(timeline_info(analysis)),
    lambda analysis: host_load_figure(host_load_info(analysis)),
)
"""Figures of one cell (data type, size, rate), which the reader picks."""
