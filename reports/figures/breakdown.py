"""Where the time goes between the planned send and the reply."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reports.figures.figure import Figure, LeftOut
from reports.figures.panels import Panel, panels_info, panels_plan
from reports.groups import data_type_label, groups_info
from reports.values import values_info

if TYPE_CHECKING:
    from analyzer.analysis import Analysis
    from reports.groups import Cell, Series

NAME = "breakdown"
TITLE = "Where the time goes, on average"
HOW_TO_READ = (
    "A whole bar is the mean response: late send (T1 - T0), the way there and back (twice the latency), and the "
    "time in the relay (T4 - T3); means are drawn because they add up and percentiles do not."
)


@dataclass(frozen=True, slots=True)
class Breakdown:
    """One panel per data type and series; x is the rank of the cell.

    Only groups whose mean response, round trip and time in the relay are all known.
    """

    panels: tuple[Panel, ...]


def breakdown_info(analysis: Analysis) -> Breakdown:
    """Every group with the three means, in the panel of its data type and series."""
    times = values_info(analysis).times_ns
    groups = groups_info(analysis)
    label_of = dict(zip(groups.series, groups.labels, strict=True))

    def title(cell: Cell, series: Series) -> str:
        return f"{data_type_label(cell.data_type)}: {label_of[series]}"

    def known(group: int) -> bool:
        return all(times[metric]["mean"][group] is not None for metric in ("response", "rtt", "intermediate"))

    return Breakdown(panels_info(analysis, lambda cell, series: (cell.data_type, series), title, drawn=known))


def breakdown_figure(info: Breakdown) -> Figure | LeftOut:
    """Stacked bars over cells."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "the time in the relay is unknown: no relay's trace was found.")
    return Figure(NAME, TITLE, HOW_TO_READ, "breakdown", panels_plan(info.panels))
