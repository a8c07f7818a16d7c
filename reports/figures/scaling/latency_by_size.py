"""The paper's second figure: latency against message size, one panel per frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.rates import format_rate

from ...book.groups import data_type_label
from ...book.values import values_info
from ..figure import Figure, LeftOut
from ..panels import Panel, panels_info, panels_plan

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

NAME = "latency_by_size"
TITLE = "Latency against size, per frequency"
HOW_TO_READ = (
    "Latency should rise gently with size; a sudden step marks a limit on the way, such as a socket buffer, "
    "a shared-memory segment or the link itself."
)


@dataclass(frozen=True, slots=True)
class LatencyBySize:
    """One panel per data type and rate; x is the payload in bytes. Only panels with two sizes at least."""

    panels: tuple[Panel, ...]


def latency_by_size_info(analysis: Analysis) -> LatencyBySize:
    """Every group that has a neighbour of another size."""
    panels = panels_info(
        analysis,
        key=lambda cell, _: (cell.data_type, cell.rate_hz),
        title=lambda cell, _: f"{data_type_label(cell.data_type)} at {format_rate(cell.rate_hz)}",
        x=lambda cell: float(cell.payload_bytes),
        drawn=values_info(analysis).timed,
    )
    return LatencyBySize(tuple(p for p in panels if len({x for line in p.lines for x in line.x}) > 1))


def latency_by_size_figure(info: LatencyBySize) -> Figure | LeftOut:
    """Lines over size on a log axis."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no data type was measured with two message sizes at one rate.")
    return Figure(
        NAME, TITLE, HOW_TO_READ, "lines", panels_plan(info.panels, x_title="Message size", x_unit="bytes")
    )
