"""Time from the first announcement of a participant to the first message that came back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.numbers import whole_ns
from .figure import Figure, LeftOut, Panel, cell_panels, figure_maker, panels_plan

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class FirstMessage:
    """One panel per data type and domain mode; x is the rank of the cell.

    Attributes:
        times_ns: group -> time, median of its runs.
    """

    panels: tuple[Panel, ...]
    times_ns: Mapping[int, int]


def first_message_info(book: Book) -> FirstMessage:
    """Collect `match_p50_ns` of `details.wire`."""
    rows = book.analysis.details.wire.select("group", "match_p50_ns").iter_rows()
    times_ns = {group: time for group, value in rows if (time := whole_ns(value)) is not None}
    return FirstMessage(cell_panels(book.groups, lambda group: group in times_ns), times_ns)


def first_message_figure(info: FirstMessage) -> Figure | LeftOut:
    """Draw a mark per group over cells."""
    name, title = "first_message", "Time to the first message"
    how_to_read = (
        "Each mark is the time from the first announcement of the ping's participant to the first echo, with a relay that was "
        "there already: what a node that starts has to wait."
    )
    if not info.panels:
        return LeftOut(name, title, "no DDS run was recorded with --wire.")
    values = {str(group): time_ns for group, time_ns in info.times_ns.items()}
    return Figure(
        name,
        title,
        how_to_read,
        "cells",
        panels_plan(info.panels, values_ns=values, label="Time to the first message"),
    )


FIGURE = figure_maker(first_message_info, first_message_figure)
