"""Where the time goes between the planned send and the reply."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..book.book import Book
from ..book.numbers import whole_ns
from .figure import Faceted, Figure, FigureMaker, LeftOut, facet_panels, facet_plan, plane_facet

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
    name: str
    mean_ns: int
    bound_ns: int | None


@dataclass(frozen=True, slots=True)
class Breakdown(Faceted):
    """Group -> its parts in the order of time; `bound_ns` is the error with which the clock fit divides the two ways."""

    parts: Mapping[int, tuple[MeanPart, ...]]


def breakdown_info(book: Book) -> Breakdown:
    parts: dict[int, list[MeanPart]] = {}
    columns = ("group", "part", "mean_ns", "bound_ns")
    rows = book.analysis.details.breakdown.sort("group", "order").select(columns)
    for group, part, mean_ns, bound_ns in rows.iter_rows():
        parts.setdefault(group, []).append(MeanPart(part, round(mean_ns), whole_ns(bound_ns)))
    facet = plane_facet(book)
    panels = facet_panels(book, facet, parts.__contains__)
    return Breakdown(facet, panels, {group: tuple(values) for group, values in parts.items()})


def breakdown_figure(info: Breakdown) -> Figure | LeftOut:
    name, title = "breakdown", "Where the time goes, on average"
    how_to_read = (
        "A whole bar is the mean response from T0 to T2, its parts from the bottom up in the order of time; means are drawn because "
        "they add up and percentiles do not."
    )
    if not info.panels:
        reason = "no message has a schedule and all four time stamps (a relay's trace is missing)."
        return LeftOut(name, title, reason)
    used = {part.name for parts in info.parts.values() for part in parts}
    names = {name: label for name, label in PART_LABELS.items() if name in used}
    plan = facet_plan(info.facet, info.panels, names=names, order=list(names), parts=info.parts)
    return Figure(name, title, how_to_read, "breakdown", plan)


FIGURE = FigureMaker(breakdown_info, breakdown_figure, opened=False)
