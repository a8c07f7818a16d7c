"""Up to which rate messages really go out and come back."""

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

NAME = "sustainable"
TITLE = "Sustainable rate"
HOW_TO_READ = (
    "Each mark is the replies per second in percent of the rate asked for (achieved rate times share received); the rate "
    "at which a line leaves 100 % is more than that choice can sustain."
)


@dataclass(frozen=True, slots=True)
class Sustainable:
    """One panel per data type and size; x is the rate asked for. Only panels with two rates at least."""

    panels: tuple[Panel, ...]


def sustainable_info(analysis: Analysis) -> Sustainable:
    """Every group whose achieved rate is known and that has a neighbour at another rate."""
    plain = values_info(analysis).plain
    panels = panels_info(
        analysis,
        key=lambda cell, _: (cell.data_type, cell.payload_bytes),
        title=lambda cell, _: f"{data_type_label(cell.data_type)} {format_size(cell.payload_bytes)}",
        x=lambda cell: cell.rate_hz,
        drawn=lambda group: (
            plain["achieved_rate_hz"][group] is not None and plain["received_ratio"][group] is not None
        ),
    )
    return Sustainable(tuple(p for p in panels if len({x for line in p.lines for x in line.x}) > 1))


def sustainable_figure(info: Sustainable) -> Figure | LeftOut:
    """Lines over the rate asked for, in percent of it."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no message size was measured at two rates.")
    return Figure(NAME, TITLE, HOW_TO_READ, "sustainable", panels_plan(info.panels))
