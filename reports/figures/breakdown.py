"""Where the time goes between the planned send and the reply."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .figure import Facet, Figure, LeftOut, Panel, facet_panels, facet_plan, figure_maker, is_few

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book


PART_LABELS = {
    "waiting_ns": "Late send (T0 to T1)",
    "outbound_ns": "Way there (T1 to T3)",
    "outbound_transport_ns": "Transport there (T1 to the relay's middleware)",
    "relay_delivery_ns": "Delivery in the relay (to T3)",
    "relay_ns": "In the relay (T3 to T4)",
    "return_ns": "Way back (T4 to T2)",
    "return_transport_ns": "Transport back (T4 to the ping's middleware)",
    "ping_delivery_ns": "Delivery in the ping (to T2)",
}
"""Part of `details.breakdown` -> label, in the order of time."""


@dataclass(frozen=True, slots=True)
class MeanPart:
    """One part of one group's mean response."""

    name: str
    mean_ns: int
    bound_ns: int | None


@dataclass(frozen=True, slots=True)
class Breakdown:
    """One panel per data type, choice and place; x is the rank of the cell.

    Attributes:
        parts: group -> its parts in the order of time. The clock fit divides the two ways; `bound_ns` is the largest
            error of that division.
    """

    facet: Facet
    panels: tuple[Panel, ...]
    parts: Mapping[int, tuple[MeanPart, ...]]


def breakdown_info(book: Book) -> Breakdown:
    """Collect the means of `details.breakdown`, in panels by data type and series."""
    parts: dict[int, list[MeanPart]] = {}
    columns = ("group", "part", "mean_ns", "bound_ns")
    for group, part, mean_ns, bound_ns in (
        book.analysis.details.breakdown.sort("group", "order").select(columns).iter_rows()
    ):
        bound = None if bound_ns is None else round(bound_ns)
        parts.setdefault(group, []).append(MeanPart(part, round(mean_ns), bound))

    facet = Facet("cell" if is_few(book) else "plane", "choice", "")
    panels = facet_panels(book, facet, parts.__contains__)
    return Breakdown(facet, panels, {group: tuple(own_parts) for group, own_parts in parts.items()})


def breakdown_figure(info: Breakdown) -> Figure | LeftOut:
    """Draw stacked bars over cells."""
    name, title = "breakdown", "Where the time goes, on average"
    how_to_read = (
        "A whole bar is the mean response from T0 to T2, its parts from below in the order of time; means are drawn because "
        "they add up and percentiles do not."
    )
    if not info.panels:
        return LeftOut(
            name, title, "no message has a schedule and all four time stamps (a relay's trace is missing)."
        )
    used = {part.name for parts in info.parts.values() for part in parts}
    return Figure(
        name,
        title,
        how_to_read,
        "breakdown",
        facet_plan(
            info.facet,
            info.panels,
            names={name: label for name, label in PART_LABELS.items() if name in used},
            order=[name for name in PART_LABELS if name in used],
            parts={str(group): parts for group, parts in info.parts.items()},
        ),
    )


FIGURE = figure_maker(breakdown_info, breakdown_figure, opened=False)
