"""How much gets through: packets received, transfer rate, and the rate that can be sustained."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .figure import Facet, Faceted, Figure, LeftOut, facet_plan, faceted, faceted_lines, figure_maker
from .latency import OVER_RATE, OVER_SIZE

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..book.book import Book


def received_info(book: Book, panels: str = "way", lines: str = "choice") -> Faceted:
    """Collect the panels in which a message was lost, every group over its cell; x is the rank of the cell."""
    ratios = book.values.plain["received_ratio"]
    spread = faceted(book, Facet("plane", panels, lines), _has(book, "received_ratio"))
    return _not_flat(spread, lambda group: (ratios[group] or 0) < 1)


def received_figure(info: Faceted) -> Figure | LeftOut:
    """Draw the paper's packets received over cells, in percent of those published."""
    name, title = "received", "Packets received"
    if not info.panels:
        return LeftOut(name, title, "every message came back, or none was published.")
    how_to_read = (
        "Everything should sit on the 100 % line; a mark below it lost that share of its messages, and its latency "
        "speaks only of those that came back."
    )
    return Figure(name, title, how_to_read, "lines", facet_plan(info.facet, info.panels, value="received"))


RECEIVED = figure_maker(received_info, received_figure, opened=False, few=False)


def transfer_rate_info(book: Book, panels: str = "way", lines: str = "choice") -> Faceted:
    """Collect every group with a transfer rate, over payload bytes times rate in bytes per second."""
    return faceted(book, Facet("load", panels, lines), _has(book, "transfer_rate_bytes_per_s"))


def transfer_rate_figure(info: Faceted) -> Figure | LeftOut:
    """Draw the paper's transfer rate on two log axes, with the diagonal of equal load."""
    name, title = "transfer_rate", "Transfer rate against offered load"
    if not info.panels:
        return LeftOut(name, title, "no group has the two messages that a transfer rate takes.")
    how_to_read = (
        "Marks on the dashed diagonal carried all that was offered (size times rate); where marks leave it to the right, "
        "more was offered than the way could carry."
    )
    plan = facet_plan(info.facet, info.panels, value="transfer", x_title="Offered load")
    return Figure(name, title, how_to_read, "lines", plan)


TRANSFER_RATE = figure_maker(transfer_rate_info, transfer_rate_figure, opened=False, few=False)


def transfer_by_size_info(book: Book, panels: str = "rate", lines: str = "choice") -> Faceted:
    """Collect every group with a transfer rate that has a neighbour of another size; x is the payload in bytes."""
    return faceted_lines(book, Facet("size", panels, lines), _has(book, "transfer_rate_bytes_per_s"))


def transfer_by_size_figure(info: Faceted) -> Figure | LeftOut:
    """Draw lines over the payload size, on two log axes."""
    name, title = "transfer_by_size", "Transfer rate against size"
    if not info.panels:
        return LeftOut(name, title, "no data type has a transfer rate at two message sizes and one rate.")
    how_to_read = (
        "A line that rises in proportion carries whatever size you send; where it bends, size is limited by what the way can carry "
        "a second."
    )
    plan = facet_plan(info.facet, info.panels, value="transfer", **OVER_SIZE)
    return Figure(name, title, how_to_read, "lines", plan)


TRANSFER_BY_SIZE = figure_maker(transfer_by_size_info, transfer_by_size_figure, opened=False, few=False)


def transfer_by_rate_info(book: Book, panels: str = "size", lines: str = "choice") -> Faceted:
    """Collect every group with a transfer rate that has a neighbour at another rate; x is the rate in Hz."""
    return faceted_lines(book, Facet("rate", panels, lines), _has(book, "transfer_rate_bytes_per_s"))


def transfer_by_rate_figure(info: Faceted) -> Figure | LeftOut:
    """Draw lines over the rate, on two log axes."""
    name, title = "transfer_by_rate", "Transfer rate against frequency"
    if not info.panels:
        return LeftOut(name, title, "no message size has a transfer rate at two rates.")
    how_to_read = "A line that rises in proportion carries as often as you send; where it bends, more messages a second bring no more bytes."
    plan = facet_plan(info.facet, info.panels, value="transfer", **OVER_RATE)
    return Figure(name, title, how_to_read, "lines", plan)


TRANSFER_BY_RATE = figure_maker(transfer_by_rate_info, transfer_by_rate_figure, opened=False, few=False)


def sustainable_info(book: Book, panels: str = "size", lines: str = "choice") -> Faceted:
    """Collect the panels in which a rate was not kept up, over two rates at least; x is the rate asked for, in Hz."""
    replies = replies_of(book)
    spread = faceted_lines(book, Facet("rate", panels, lines), lambda group: replies(group) is not None)
    return _not_flat(spread, lambda group: (replies(group) or 0) < KEPT_UP)


def sustainable_figure(info: Faceted) -> Figure | LeftOut:
    """Draw replies per second over the rate asked for, in percent of it."""
    name, title = "sustainable", "Sustainable rate"
    if not info.panels:
        return LeftOut(name, title, "every rate was kept up, or no message size was measured at two rates.")
    how_to_read = (
        "Each mark is the replies per second in percent of the rate asked for (achieved rate times share received); the rate "
        "at which a line leaves 100 % is more than that choice can sustain."
    )
    plan = facet_plan(info.facet, info.panels, value="sustained", x_title="Rate asked for (Hz)")
    return Figure(name, title, how_to_read, "lines", plan)


SUSTAINABLE = figure_maker(sustainable_info, sustainable_figure, opened=False, few=False)


def replies_of(book: Book) -> Callable[[int], float | None]:
    """Return what gives a group's replies per second as a share of the rate asked for; None where one is not known."""
    achieved, received = (book.values.plain[name] for name in ("achieved_rate_hz", "received_ratio"))
    rates = [book.groups.cell_of(group).rate_hz for group in book.groups.groups]

    def replies(group: int) -> float | None:
        got, share = achieved[group], received[group]
        return None if got is None or share is None else got * share / rates[group]

    return replies


KEPT_UP = 0.99
"""Replies per second as a share of the rate asked for, from which on a rate counts as kept up."""


def _not_flat(spread: Faceted, shows: Callable[[int], bool]) -> Faceted:
    """Keep the panels in which any group shows something."""
    panels = tuple(
        panel for panel in spread.panels if any(shows(group) for line in panel.lines for group in line.groups)
    )
    return Faceted(spread.facet, panels)


def _has(book: Book, column: str) -> Callable[[int], bool]:
    values = book.values.plain[column]
    return lambda group: values[group] is not None
