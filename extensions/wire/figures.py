"""The wire: bytes by class of traffic, messages sent again, time to the first message."""

from __future__ import annotations

from dataclasses import dataclass

from dds_trace.reports.book.book import Book
from dds_trace.reports.book.numbers import whole_ns
from dds_trace.reports.figures.figure import FigureMaker, Plan, Scope, plane_facet, spread_plan

from .format import AGAIN_CLASSES, DISCOVERY_CLASSES

PART_LABELS = {
    "data": "Data, first time",
    "again": "Data sent again",
    "control": "Heartbeats, acknowledgements",
    "discovery": "Discovery",
    "other": "Other",
}

_CLASSES = {
    "data": ("data", "data_frag", "tcp_data", "udp_other", "fragment_unknown"),
    "again": AGAIN_CLASSES,
    "control": ("heartbeat", "heartbeat_frag", "acknack", "nack_frag", "gap", "tcp_control"),
    "discovery": DISCOVERY_CLASSES,
}
PART_OF_CLASS = {name: part for part, names in _CLASSES.items() for name in names}
"""Class of traffic (`docs/reference/wire.md`) -> part of the bar; other classes are `other`. What is not RTPS, and later IP
fragments, are usually data."""


@dataclass(frozen=True, slots=True)
class WirePart:
    """One part of the bytes that one payload byte costs: their ratio, and their share of all."""

    name: str
    ratio: float
    share: float


def wire_cost_plan(book: Book) -> Plan | None:
    details = book.analysis.details
    ratios = dict(details.wire.select("group", "bytes_per_payload_byte").drop_nulls().iter_rows())
    shares: dict[int, dict[str, float]] = {}
    for group, wire_class, share in details.wire_classes.select("group", "wire_class", "share").iter_rows():
        if group in ratios:
            part = PART_OF_CLASS.get(wire_class, "other")
            shares.setdefault(group, dict.fromkeys(PART_LABELS, 0.0))[part] += share
    parts = {
        group: tuple(WirePart(name, share * ratios[group], share) for name, share in parts.items() if share)
        for group, parts in shares.items()
    }
    used = {part.name for group_parts in parts.values() for part in group_parts}
    return spread_plan(
        book,
        plane_facet(book),
        parts.__contains__,
        names={name: label for name, label in PART_LABELS.items() if name in used},
        parts=parts,
        incomplete=details.wire.filter(~details.wire["complete"])["group"].to_list(),
    )


WIRE_COST = FigureMaker(
    name="wire_cost",
    title="What a message costs",
    how_to_read=(
        "A whole bar is the bytes on the wire for each byte of payload, both ways, with all headers; what is above 1 is the price of the "
        "middleware, by what it was spent on."
    ),
    nothing="no run was recorded with --wire.",
    kind="wire_cost",
    make=wire_cost_plan,
)


@dataclass(frozen=True, slots=True)
class Repeats:
    repeats: int
    messages: int
    p50_ns: int | None
    max_ns: int | None


def sent_again_plan(book: Book) -> Plan | None:
    """Groups that sent a message again -> their messages by how often, ascending; `metric` is `rtt` without a relay's trace."""
    frame = book.analysis.details.wire_repeats
    metric = "latency" if frame["latency_p50_ns"].count() == frame["rtt_p50_ns"].count() else "rtt"
    columns = ("group", "repeats", "messages", f"{metric}_p50_ns", f"{metric}_max_ns")
    groups: dict[int, list[Repeats]] = {}
    for group, repeats, messages, p50_ns, max_ns in frame.select(columns).iter_rows():
        groups.setdefault(group, []).append(Repeats(repeats, messages, whole_ns(p50_ns), whole_ns(max_ns)))
    again = {group: tuple(rows) for group, rows in groups.items() if any(row.repeats for row in rows)}
    return {"groups": again, "metric": metric} if again else None


SENT_AGAIN = FigureMaker(
    name="sent_again",
    title="Sent again",
    how_to_read=(
        "Each mark is the median time of the messages that were sent again so often, its bar reaches to the slowest; a step from 0 to 1 is "
        "the price of one loss, and where it is a heartbeat's period, recovery waits for heartbeats."
    ),
    nothing="no message was sent again, or no run was recorded with --wire.",
    kind="sent_again",
    make=sent_again_plan,
    scope=Scope.CELL,
)


FIGURES = (WIRE_COST, SENT_AGAIN)
