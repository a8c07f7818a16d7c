"""The wire: bytes by class of traffic, messages sent again, time to the first message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dds_trace.tracefile.format.wire import AGAIN_CLASSES, DISCOVERY_CLASSES

from ..book.book import Book
from ..book.numbers import whole_ns
from .figure import Faceted, Figure, FigureMaker, LeftOut, Scope, facet_panels, facet_plan, plane_facet

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


@dataclass(frozen=True, slots=True)
class WireCost(Faceted):
    parts: Mapping[int, tuple[WirePart, ...]]
    incomplete: tuple[int, ...]


def wire_cost_info(book: Book) -> WireCost:
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
    facet = plane_facet(book)
    incomplete = details.wire.filter(~details.wire["complete"])["group"].to_list()
    return WireCost(facet, facet_panels(book, facet, shares.__contains__), parts, tuple(incomplete))


def wire_cost_figure(info: WireCost) -> Figure | LeftOut:
    name, title = "wire_cost", "What a message costs"
    how_to_read = (
        "A whole bar is the bytes on the wire for each byte of payload, both ways, with all headers; what is above 1 is the price of the "
        "middleware, by what it was spent on."
    )
    if not info.panels:
        return LeftOut(name, title, "no run was recorded with --wire.")
    used = {part.name for parts in info.parts.values() for part in parts}
    plan = facet_plan(
        info.facet,
        info.panels,
        names={name: label for name, label in PART_LABELS.items() if name in used},
        parts=info.parts,
        incomplete=info.incomplete,
    )
    return Figure(name, title, how_to_read, "wire_cost", plan)


WIRE_COST = FigureMaker(wire_cost_info, wire_cost_figure)


@dataclass(frozen=True, slots=True)
class Repeats:
    repeats: int
    messages: int
    p50_ns: int | None
    max_ns: int | None


@dataclass(frozen=True, slots=True)
class SentAgain:
    """Groups that sent a message again -> their messages by how often, ascending; `metric` is `rtt` without a relay's trace."""

    groups: Mapping[int, tuple[Repeats, ...]]
    metric: str


def sent_again_info(book: Book) -> SentAgain:
    frame = book.analysis.details.wire_repeats
    metric = "latency" if frame["latency_p50_ns"].count() == frame["rtt_p50_ns"].count() else "rtt"
    columns = ("group", "repeats", "messages", f"{metric}_p50_ns", f"{metric}_max_ns")
    groups: dict[int, list[Repeats]] = {}
    for group, repeats, messages, p50_ns, max_ns in frame.select(columns).iter_rows():
        groups.setdefault(group, []).append(Repeats(repeats, messages, whole_ns(p50_ns), whole_ns(max_ns)))
    again = {group: tuple(rows) for group, rows in groups.items() if any(row.repeats for row in rows)}
    return SentAgain(again, metric)


def sent_again_figure(info: SentAgain) -> Figure | LeftOut:
    name, title = "sent_again", "Sent again"
    how_to_read = (
        "Each mark is the median time of the messages that were sent again so often, its bar reaches to the slowest; a step from 0 to 1 is "
        "the price of one loss, and where it is a heartbeat's period, recovery waits for heartbeats."
    )
    if not info.groups:
        return LeftOut(name, title, "no message was sent again, or no run was recorded with --wire.")
    return Figure(name, title, how_to_read, "sent_again", {"groups": info.groups, "metric": info.metric})


SENT_AGAIN = FigureMaker(sent_again_info, sent_again_figure, Scope.CELL)
