"""The way out against the way back, as far as the clocks can tell them apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.groups import STATISTICS, data_type_label
from .figure import Figure, LeftOut, Panel, figure_maker, panels_info, panels_plan

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book
    from ..book.groups import Cell, Series

NAME = "one_way"
TITLE = "The way out against the way back"
HOW_TO_READ = (
    "Full marks are the way out, open marks the way back; a bar is how far the clocks of the two devices may be off, and asymmetry inside it "
    "cannot be seen."
)


@dataclass(frozen=True, slots=True)
class Way:
    """One-way times of one group, by statistic, ns; and how far they may be off (`bound_ns`, for half of the messages less)."""

    outbound_ns: Mapping[str, int | None]
    return_ns: Mapping[str, int | None]
    bound_ns: int | None


@dataclass(frozen=True, slots=True)
class OneWay:
    """One panel per data type and series; x is the rank of the cell."""

    panels: tuple[Panel, ...]
    ways: Mapping[int, Way]


def one_way_info(book: Book) -> OneWay:
    """The rows of `details.one_way`."""
    groups = book.groups
    label_of = dict(zip(groups.series, groups.labels, strict=True))
    found: dict[int, dict[str, Way]] = {}
    if book.analysis.details is not None:
        for row in book.analysis.details.one_way.iter_rows(named=True):
            times = {name: _whole(row[f"{name}_ns"]) for name in STATISTICS}
            found.setdefault(row["group"], {})[row["metric"]] = Way(times, times, _whole(row["bound_p50_ns"]))
    ways = {
        group: Way(both["outbound"].outbound_ns, both["return"].return_ns, both["outbound"].bound_ns)
        for group, both in found.items()
        if both.keys() == {"outbound", "return"}
    }

    def title(cell: Cell, series: Series) -> str:
        return f"{data_type_label(cell.data_type)}: {label_of[series]}"

    panels = panels_info(
        book.groups, lambda cell, series: (cell.data_type, series), title, drawn=lambda group: group in ways
    )
    return OneWay(panels, ways)


def one_way_figure(info: OneWay) -> Figure | LeftOut:
    """Two marks over each cell."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no message has all four time stamps (a relay's trace is missing).")
    ways = {str(group): way for group, way in info.ways.items()}
    return Figure(NAME, TITLE, HOW_TO_READ, "one_way", panels_plan(info.panels, ways=ways))


FIGURE = figure_maker(one_way_info, one_way_figure)


def _whole(value_ns: float | None) -> int | None:
    return None if value_ns is None or not math.isfinite(value_ns) else round(value_ns)
