"""Time from the first announcement of a participant to the first message that came back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.numbers import whole_ns
from .figure import Facet, Figure, LeftOut, Panel, facet_panels, facet_plan, figure_maker, is_few

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class FirstMessage:
    """Groups over their cell; x is its rank.

    Attributes:
        times_ns: group -> time, median of its runs.
    """

    facet: Facet
    panels: tuple[Panel, ...]
    times_ns: Mapping[int, int]


def first_message_info(book: Book) -> FirstMessage:
    """Collect `match_p50_ns` of `details.wire`."""
    rows = book.analysis.details.wire.select("group", "match_p50_ns").iter_rows()
    times_ns = {group: time for group, value in rows if (time := whole_ns(value)) is not None}
    facet = Facet("cell" if is_few(book) else "plane", "way")
    return FirstMessage(facet, facet_panels(book, facet, times_ns.__contains__), times_ns)


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
    plan = facet_plan(
        info.facet, info.panels, value="own", values_ns=values, label="Time to the first message"
    )
    return Figure(name, title, how_to_read, "lines", plan)


FIGURE = figure_maker(first_message_info, first_message_figure, opened=False)
