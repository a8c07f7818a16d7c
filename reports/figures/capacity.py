"""How much gets through: packets received, transfer rate against offered load, and the rate that can be sustained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.sizes import format_size

from ..book.groups import data_type_label
from .figure import (
    Figure,
    LeftOut,
    Panel,
    cell_panels,
    figure_maker,
    over_two_positions,
    panels_info,
    panels_plan,
)

if TYPE_CHECKING:
    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class Received:
    """One panel per data type and domain mode; x is the rank of the cell."""

    panels: tuple[Panel, ...]


def received_info(book: Book) -> Received:
    """Collect every group that published a message, over its cell."""
    ratios = book.values.plain["received_ratio"]
    return Received(cell_panels(book.groups, lambda group: ratios[group] is not None))


def received_figure(info: Received) -> Figure | LeftOut:
    """Draw the paper's packets received over cells, in percent of those published."""
    name, title = "received", "Packets received"
    if not info.panels:
        return LeftOut(name, title, "no message was published.")
    how_to_read = (
        "Everything should sit on the 100 % line; a mark below it lost that share of its messages, and its latency "
        "speaks only of those that came back."
    )
    return Figure(name, title, how_to_read, "cells", panels_plan(info.panels, value="received_ratio"))


RECEIVED = figure_maker(received_info, received_figure)


@dataclass(frozen=True, slots=True)
class TransferRate:
    """One panel per data type; x is the offered load in bytes per second. Only groups with a transfer rate."""

    panels: tuple[Panel, ...]


def transfer_rate_info(book: Book) -> TransferRate:
    """Collect every group with a transfer rate, over payload bytes times rate."""
    rates = book.values.plain["transfer_rate_bytes_per_s"]
    return TransferRate(
        panels_info(
            book.groups,
            key=lambda cell, _: cell.data_type,
            title=lambda cell, _: data_type_label(cell.data_type),
            x=lambda cell: cell.payload_bytes * cell.rate_hz,
            drawn=lambda group: rates[group] is not None,
        )
    )


def transfer_rate_figure(info: TransferRate) -> Figure | LeftOut:
    """Draw the paper's transfer rate on two log axes, with the diagonal of equal load."""
    name, title = "transfer_rate", "Transfer rate against offered load"
    if not info.panels:
        return LeftOut(name, title, "no group has the two messages that a transfer rate takes.")
    how_to_read = (
        "Marks on the dashed diagonal carried all that was offered (size times rate); where marks leave it to the right, "
        "more was offered than the way could carry."
    )
    return Figure(name, title, how_to_read, "load", panels_plan(info.panels))


TRANSFER_RATE = figure_maker(transfer_rate_info, transfer_rate_figure)


@dataclass(frozen=True, slots=True)
class Sustainable:
    """One panel per data type and size; x is the rate asked for, in Hz. Only panels with two rates at least."""

    panels: tuple[Panel, ...]


def sustainable_info(book: Book) -> Sustainable:
    """Collect every group of known achieved rate that has a neighbour at another rate."""
    plain = book.values.plain
    panels = panels_info(
        book.groups,
        key=lambda cell, _: (cell.data_type, cell.payload_bytes),
        title=lambda cell, _: f"{data_type_label(cell.data_type)} {format_size(cell.payload_bytes)}",
        x=lambda cell: cell.rate_hz,
        drawn=lambda group: (
            plain["achieved_rate_hz"][group] is not None and plain["received_ratio"][group] is not None
        ),
    )
    return Sustainable(over_two_positions(panels))


def sustainable_figure(info: Sustainable) -> Figure | LeftOut:
    """Draw replies per second over the rate asked for, in percent of it."""
    name, title = "sustainable", "Sustainable rate"
    if not info.panels:
        return LeftOut(name, title, "no message size was measured at two rates.")
    how_to_read = (
        "Each mark is the replies per second in percent of the rate asked for (achieved rate times share received); the rate "
        "at which a line leaves 100 % is more than that choice can sustain."
    )
    return Figure(name, title, how_to_read, "sustainable", panels_plan(info.panels))


SUSTAINABLE = figure_maker(sustainable_info, sustainable_figure)
