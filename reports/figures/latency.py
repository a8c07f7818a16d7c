"""Latency against rate, against size, and over the plane of both; the time in the relay beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.groups import data_type_label
from .figure import Facet, Faceted, Figure, LeftOut, facet_plan, faceted_lines, figure_maker

if TYPE_CHECKING:
    from ..book.book import Book

OVER_RATE = {"x_title": "Rate (Hz)"}
OVER_SIZE = {"x_title": "Message size"}
"""Settings of the axis of a figure of lines."""


def latency_by_rate_info(book: Book, panels: str = "size", lines: str = "choice") -> Faceted:
    """Collect every group with a time that has a neighbour at another rate; x is the rate in Hz."""
    return faceted_lines(book, Facet("rate", panels, lines), book.values.timed)


def latency_by_rate_figure(info: Faceted) -> Figure | LeftOut:
    """Draw lines over the rate, on a log axis."""
    name, title = "latency_by_rate", "Latency against frequency"
    if not info.panels:
        return LeftOut(name, title, "no message size was measured at two rates.")
    how_to_read = (
        "A flat line does not care how often you send; a line that climbs to the right is running out of capacity, "
        "one that falls is waking up from sleep."
    )
    plan = facet_plan(info.facet, info.panels, value="statistic", **OVER_RATE)
    return Figure(name, title, how_to_read, "lines", plan, follows=True)


LATENCY_BY_RATE = figure_maker(latency_by_rate_info, latency_by_rate_figure, few=False)


def latency_by_size_info(book: Book, panels: str = "rate", lines: str = "choice") -> Faceted:
    """Collect every group with a time that has a neighbour of another size; x is the payload in bytes."""
    return faceted_lines(book, Facet("size", panels, lines), book.values.timed)


def latency_by_size_figure(info: Faceted) -> Figure | LeftOut:
    """Draw lines over the payload size, on a log axis."""
    name, title = "latency_by_size", "Latency against size"
    if not info.panels:
        return LeftOut(name, title, "no data type was measured with two message sizes at one rate.")
    how_to_read = (
        "Latency should rise gently with size; a sudden step marks a limit on the way, such as a socket buffer, "
        "a shared-memory segment or the link itself."
    )
    plan = facet_plan(info.facet, info.panels, value="statistic", **OVER_SIZE)
    return Figure(name, title, how_to_read, "lines", plan, follows=True)


LATENCY_BY_SIZE = figure_maker(latency_by_size_info, latency_by_size_figure, few=False)


def relay_time_info(book: Book, panels: str = "rate", lines: str = "choice") -> Faceted:
    """Collect every group with a time in the relay that has a neighbour of another size; x is the payload in bytes."""
    times = book.values.times_ns["intermediate"]["p50"]
    return faceted_lines(book, Facet("size", panels, lines), lambda group: times[group] is not None)


def relay_time_figure(info: Faceted) -> Figure | LeftOut:
    """Draw lines over the payload size, on a log axis."""
    name, title = "relay_time", "Time in the relay against size"
    if not info.panels:
        return LeftOut(name, title, "no data type has a time in the relay at two message sizes.")
    how_to_read = (
        "What passes between a message's arrival at the relay and its way back (the paper's intermediate-process time) is not part "
        "of the latency; where it grows with size, the relay copies or serializes."
    )
    plan = facet_plan(info.facet, info.panels, value="statistic", metric="intermediate", **OVER_SIZE)
    return Figure(name, title, how_to_read, "lines", plan)


RELAY_TIME = figure_maker(relay_time_info, relay_time_figure, opened=False, few=False)


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


HEATMAP = figure_maker(heatmap_info, heatmap_figure, opened=False, few=False)
