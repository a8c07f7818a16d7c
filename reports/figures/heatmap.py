"""Latency over the plane of sizes and rates, a panel for each setup."""

from __future__ import annotations

from dataclasses import dataclass

from ..book.book import Book
from ..book.groups import data_type_label
from .figure import Figure, FigureMaker, LeftOut


@dataclass(frozen=True, slots=True)
class HeatmapPanel:
    """Plane of one setup and data type; `tiles` are (payload in bytes, rate in Hz, group) of what was measured."""

    title: str
    tiles: tuple[tuple[int, float, int], ...]


@dataclass(frozen=True, slots=True)
class Heatmap:
    panels: tuple[HeatmapPanel, ...]


def heatmap_info(book: Book) -> Heatmap:
    groups = book.groups
    planes: dict[tuple[str, int], list[tuple[int, float, int]]] = {}
    for group in groups.in_order:
        cell = groups.cell_of(group)
        tile = (cell.payload_bytes, cell.rate_hz, group.index)
        planes.setdefault((cell.data_type, group.series), []).append(tile)
    return Heatmap(
        tuple(
            HeatmapPanel(f"{data_type_label(data_type)}: {groups.labels[series]}", tuple(tiles))
            for (data_type, series), tiles in planes.items()
            if len(tiles) > 1
        )
    )


def heatmap_figure(info: Heatmap) -> Figure | LeftOut:
    name, title = "heatmap", "Size by rate, a panel for each setup"
    how_to_read = "Each tile is one size (upwards) at one rate (to the right), all panels on one colour scale; an empty tile was not measured."
    if not info.panels:
        return LeftOut(name, title, "no data type was measured at two sizes or rates with one setup.")
    return Figure(name, title, how_to_read, "heatmap", {"panels": info.panels})


FIGURE = FigureMaker(heatmap_info, heatmap_figure, opened=False, few=False)
