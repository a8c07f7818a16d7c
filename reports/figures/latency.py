"""Latency against rate with a panel per size, against size with a panel per rate, and over the plane of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.rates import format_rate
from dds_trace.tracefile.units.sizes import format_size

from ..book.groups import data_type_label
from .figure import Figure, LeftOut, Panel, figure_maker, over_two_positions, panels_info, panels_plan

if TYPE_CHECKING:
    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class LatencyByRate:
    """One panel per data type and size; x is the rate in Hz. Only panels with two rates at least."""

    panels: tuple[Panel, ...]


def latency_by_rate_info(book: Book) -> LatencyByRate:
    """Collect every group that has a neighbour at another rate."""
    panels = panels_info(
        book.groups,
        key=lambda cell, _: (cell.data_type, cell.payload_bytes),
        title=lambda cell, _: f"{data_type_label(cell.data_type)} {format_size(cell.payload_bytes)}",
        x=lambda cell: cell.rate_hz,
        drawn=book.values.timed,
    )
    return LatencyByRate(over_two_positions(panels))


def latency_by_rate_figure(info: LatencyByRate) -> Figure | LeftOut:
    """Draw lines over the rate, on a log axis."""
    name, title = "latency_by_rate", "Latency against frequency, per size"
    if not info.panels:
        return LeftOut(name, title, "no message size was measured at two rates.")
    how_to_read = (
        "A flat line does not care how often you send; a line that climbs to the right is running out of capacity, "
        "one that falls is waking up from sleep."
    )
    return Figure(
        name, title, how_to_read, "lines", panels_plan(info.panels, x_title="Rate (Hz)", x_unit="hz")
    )


LATENCY_BY_RATE = figure_maker(latency_by_rate_info, latency_by_rate_figure)


@dataclass(frozen=True, slots=True)
class LatencyBySize:
    """One panel per data type and rate; x is the payload in bytes. Only panels with two sizes at least."""

    panels: tuple[Panel, ...]


def latency_by_size_info(book: Book) -> LatencyBySize:
    """Collect every group that has a neighbour of another size."""
    panels = panels_info(
        book.groups,
        key=lambda cell, _: (cell.data_type, cell.rate_hz),
        title=lambda cell, _: f"{data_type_label(cell.data_type)} at {format_rate(cell.rate_hz)}",
        x=lambda cell: float(cell.payload_bytes),
        drawn=book.values.timed,
    )
    return LatencyBySize(over_two_positions(panels))


def latency_by_size_figure(info: LatencyBySize) -> Figure | LeftOut:
    """Draw lines over the payload size, on a log axis."""
    name, title = "latency_by_size", "Latency against size, per frequency"
    if not info.panels:
        return LeftOut(name, title, "no data type was measured with two message sizes at one rate.")
    how_to_read = (
        "Latency should rise gently with size; a sudden step marks a limit on the way, such as a socket buffer, "
        "a shared-memory segment or the link itself."
    )
    return Figure(
        name, title, how_to_read, "lines", panels_plan(info.panels, x_title="Message size", x_unit="bytes")
    )


LATENCY_BY_SIZE = figure_maker(latency_by_size_info, latency_by_size_figure)


@dataclass(frozen=True, slots=True)
class HeatmapPanel:
    """Plane of one series and data type.

    Attributes:
        tiles: (payload in bytes, rate in Hz, group) of every measured tile.
    """

    title: str
    tiles: tuple[tuple[int, float, int], ...]


@dataclass(frozen=True, slots=True)
class Heatmap:
    """Panels by data type, then series. Only planes with two tiles at least."""

    panels: tuple[HeatmapPanel, ...]


def heatmap_info(book: Book) -> Heatmap:
    """Collect every group as a tile of its series' plane."""
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
    """Draw tiles, with the value inside where there is room."""
    name, title = "heatmap", "Size by rate, a panel for each choice"
    how_to_read = (
        "Each tile is one size (upwards) at one rate (to the right), all panels on one colour scale; an empty place "
        "was not measured."
    )
    if not info.panels:
        return LeftOut(name, title, "no data type was measured at two sizes or rates by one choice.")
    return Figure(name, title, how_to_read, "heatmap", {"panels": info.panels})


HEATMAP = figure_maker(heatmap_info, heatmap_figure)
