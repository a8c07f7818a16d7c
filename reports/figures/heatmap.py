"""The whole plane of sizes and rates at a glance, one panel per series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.groups import data_type_label
from .figure import Figure, LeftOut, figure_maker

if TYPE_CHECKING:
    from ..book.book import Book

NAME = "heatmap"
TITLE = "Size by rate, per vendor"
HOW_TO_READ = (
    "Each tile is one size (upwards) at one rate (to the right), all panels on one colour scale; an empty place "
    "was not measured."
)


@dataclass(frozen=True, slots=True)
class HeatmapPanel:
    """The plane of one series and data type.

    Attributes:
        tiles: (payload bytes, rate, group) of every tile that was measured.
    """

    title: str
    tiles: tuple[tuple[int, float, int], ...]


@dataclass(frozen=True, slots=True)
class Heatmap:
    """Panels by data type, then series; only planes with two tiles at least."""

    panels: tuple[HeatmapPanel, ...]


def heatmap_info(book: Book) -> Heatmap:
    """Every group, as a tile of its series' plane."""
    groups = book.groups
    planes: dict[tuple[str, int], list[tuple[int, float, int]]] = {}
    for group in sorted(groups.groups, key=lambda group: (group.cell, group.series)):
        cell = groups.cell_of(group)
        planes.setdefault((cell.data_type, group.series), []).append(
            (cell.payload_bytes, cell.rate_hz, group.index)
        )
    return Heatmap(
        tuple(
            HeatmapPanel(f"{data_type_label(data_type)}: {groups.labels[series]}", tuple(tiles))
            for (data_type, series), tiles in planes.items()
            if len(tiles) > 1
        )
    )


def heatmap_figure(info: Heatmap) -> Figure | LeftOut:
    """Tiles with the value written in them where there is room."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no data type was measured at two sizes or rates by one series.")
    return Figure(NAME, TITLE, HOW_TO_READ, "heatmap", {"panels": info.panels})


FIGURE = figure_maker(heatmap_info, heatmap_figure)
