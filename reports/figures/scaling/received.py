"""The paper's packets received, in percent of those published."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...book.values import values_info
from ..comparison.vendor_comparison import cell_panels
from ..figure import Figure, LeftOut
from ..panels import Panel, panels_plan

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

NAME = "received"
TITLE = "Packets received"
HOW_TO_READ = (
    "Everything should sit on the 100 % line; a mark below it lost that share of its messages, and its latency "
    "speaks only of those that came back."
)


@dataclass(frozen=True, slots=True)
class Received:
    """One panel per data type and domain mode; x is the rank of the cell."""

    panels: tuple[Panel, ...]


def received_info(analysis: Analysis) -> Received:
    """Every group, over its cell."""
    ratios = values_info(analysis).plain["received_ratio"]
    return Received(cell_panels(analysis, lambda group: ratios[group] is not None))


def received_figure(info: Received) -> Figure | LeftOut:
    """Marks over cells, in percent."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no message was published.")
    return Figure(NAME, TITLE, HOW_TO_READ, "cells", panels_plan(info.panels, value="received_ratio"))
