"""Where the time goes between the planned send and the reply."""

from __future__ import annotations

from dataclasses import dataclass

from ..book.book import Book
from ..book.numbers import whole_ns
from .figure import FigureMaker, Plan, plane_facet, spread_plan

PART_LABELS = {
    "waiting_ns": "Late send (T0 to T1)",
    "outbound_ns": "Way there (T1 to T3)",
    "outbound_transport_ns": "Transport there (T1 to arrival)",
    "relay_delivery_ns": "Delivery in relay (to T3)",
    "relay_ns": "In relay (T3 to T4)",
    "return_ns": "Way back (T4 to T2)",
    "return_transport_ns": "Transport back (T4 to arrival)",
    "ping_delivery_ns": "Delivery in ping (to T2)",
}
"""Part of `details.breakdown` -> label, in the order of time."""


@dataclass(frozen=True, slots=True)
class MeanPart:
    name: str
    mean_ns: int
    bound_ns: int | None


def breakdown_plan(book: Book) -> Plan | None:
    """`bound_ns` is the error with which the clock fit divides the two ways."""
    parts: dict[int, list[MeanPart]] = {}
    columns = ("group", "part", "mean_ns", "bound_ns")
    rows = book.analysis.details.breakdown.sort("group", "order").select(columns)
    for group, part, mean_ns, bound_ns in rows.iter_rows():
        parts.setdefault(group, []).append(MeanPart(part, round(mean_ns), whole_ns(bound_ns)))
    used = {part.name for group_parts in parts.values() for part in group_parts}
    names = {name: label for name, label in PART_LABELS.items() if name in used}
    return spread_plan(book, plane_facet(book), parts.__contains__, names=names, order=[*names], parts=parts)


FIGURE = FigureMaker(
    name="breakdown",
    title="Where the time goes, on average",
    how_to_read=(
        "Each bar divides its mean response (100 %), from the planned send (T0) over sent (T1), at the relay (T3) and sent back (T4) to the reply (T2), "
        "its parts upwards in that order; means add up, percentiles do not."
    ),
    nothing="no message has a schedule and all four time stamps (a relay's trace is missing).",
    kind="breakdown",
    make=breakdown_plan,
    opened=False,
)
