"""The paper's first figure: latency against frequency, one panel per message size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.sizes import format_size

from ...book.groups import data_type_label
from ...book.values import values_info
from ..figure import Figure, LeftOut
from ..panels import Panel, panels_info, panels_plan

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

NAME = "latency_by_rate"
TITLE = "Latency against frequency, per size"
HOW_TO_READ = (
    "A flat line does not care how often you send; a line that climbs to the right is running out of capacity, "
    "one that falls is waking up from sleep."
)


@dataclass(frozen=True, slots=True)
class LatencyByRate:
    """One panel per data type and size; x is the rate in Hz. Only panels with two rates at least."""

    panels: tuple[Panel, ...]


def latency_by_rate_info(analysis: Analysis) -> LatencyByRate:
    """Every group that has a neighbour at another rate."""
    panels = panels_info(
        analysis,
        key=lambda cell, _: (cell.data_type, cell.payload_bytes),
        title=lambda cell, _: f"{data_type_label(cell.data_type)} {format_size(cell.payload_bytes)}",
        x=lambda cell: cell.rate_hz,
        drawn=values_info(analysis).timed,
    )
    return LatencyByRate(tuple(p for p in panels if len({x for line in p.lines for x in line.x}) > 1))


def latency_by_rate_figure(info: LatencyByRate) -> Figure | LeftOut:
    """Lines over rate on a log axis."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no message size was measured at two rates.")
    return Figure(
        NAME, TITLE, HOW_TO_READ, "lines", panels_plan(info.panels, x_title="Rate (Hz)", x_unit="hz")
    )
