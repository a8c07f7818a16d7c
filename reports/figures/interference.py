"""How many times as long messages take with other flows, or under a load, as without."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..book.book import Book
from .bridge_cost import BridgedCell, Cost, cost_of
from .figure import Facet, Faceted, Figure, FigureMaker, LeftOut, facet_panels, facet_plan


@dataclass(frozen=True, slots=True)
class Interference(Faceted):
    """Groups with other flows or a load -> p50 and p99 of the latency against the same without."""

    cells: Mapping[int, BridgedCell]


def interference_info(book: Book) -> Interference:
    costs: dict[int, dict[str, Cost]] = {}
    for row in book.analysis.details.interference.iter_rows(named=True):
        if (cost := cost_of(row)) is not None:
            costs.setdefault(row["group"], {})[row["statistic"]] = cost
    cells = {group: BridgedCell(own, None) for group, own in costs.items()}
    facet = Facet("plane", "place")
    return Interference(facet, facet_panels(book, facet, cells.__contains__), cells)


def interference_figure(info: Interference) -> Figure | LeftOut:
    name, title = "interference", "What other flows and loads cost"
    how_to_read = (
        "Each mark is how many times as long a message takes with the other flows or the load that its setting names as without, with its "
        "95 % interval and the difference; an interval that reaches the line shows no difference that these samples can prove."
    )
    if not info.panels:
        return LeftOut(name, title, "nothing was recorded both with and without other flows, or a load.")
    cells = {str(group): cell for group, cell in info.cells.items()}
    return Figure(name, title, how_to_read, "bridge_cost", facet_plan(info.facet, info.panels, cells=cells))


FIGURE = FigureMaker(interference_info, interference_figure)
