"""What a message costs on the wire: bytes per payload byte, by class of traffic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .figure import Facet, Figure, LeftOut, Panel, facet_panels, facet_plan, figure_maker, is_few

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book

PART_LABELS = {
    "data": "Data, first time",
    "again": "Data sent again",
    "control": "Heartbeats, acknowledgements",
    "discovery": "Discovery",
    "other": "Other",
}
"""Part of a bar -> label, in the order from below."""

PART_OF_CLASS = {
    "data": "data",
    "data_frag": "data",
    "tcp_data": "data",
    "udp_other": "data",
    "fragment_unknown": "data",
    "data_again": "again",
    "data_frag_again": "again",
    "tcp_data_again": "again",
    "heartbeat": "control",
    "heartbeat_frag": "control",
    "acknack": "control",
    "nack_frag": "control",
    "gap": "control",
    "tcp_control": "control",
    "spdp": "discovery",
    "sedp": "discovery",
    "liveliness": "discovery",
}
"""Class of traffic (`docs/reference/wire.md`) -> part of the bar; other classes are `other`. What is not RTPS, and later IP fragments,
are data as a rule."""


@dataclass(frozen=True, slots=True)
class WirePart:
    """One part of the bytes that one payload byte costs.

    Attributes:
        name: key of `PART_LABELS`.
        ratio: bytes on the wire per payload byte.
        share: share of all bytes on the wire.
    """

    name: str
    ratio: float
    share: float


@dataclass(frozen=True, slots=True)
class WireCost:
    """One panel per data type, choice and place; x is the rank of the cell.

    Attributes:
        parts: group -> its parts, in the order of `PART_LABELS`.
        incomplete: groups of which the kernel dropped packets, so that the bars are too low.
    """

    facet: Facet
    panels: tuple[Panel, ...]
    parts: Mapping[int, tuple[WirePart, ...]]
    incomplete: tuple[int, ...]


def wire_cost_info(book: Book) -> WireCost:
    """Collect the classes of `details.wire_classes` and the groups' bytes per payload byte."""
    details = book.analysis.details
    ratios = dict(details.wire.select("group", "bytes_per_payload_byte").drop_nulls().iter_rows())
    shares: dict[int, dict[str, float]] = {}
    for group, wire_class, share in details.wire_classes.select("group", "wire_class", "share").iter_rows():
        if group in ratios:
            part = PART_OF_CLASS.get(wire_class, "other")
            of_group = shares.setdefault(group, {})
            of_group[part] = of_group.get(part, 0.0) + share

    facet = Facet("cell" if is_few(book) else "plane", "choice", "")
    panels = facet_panels(book, facet, shares.__contains__)
    parts = {
        group: tuple(
            WirePart(name, of_group[name] * ratios[group], of_group[name])
            for name in PART_LABELS
            if name in of_group
        )
        for group, of_group in shares.items()
    }
    incomplete = details.wire.filter(~details.wire["complete"])["group"].to_list()
    return WireCost(facet, panels, parts, tuple(incomplete))


def wire_cost_figure(info: WireCost) -> Figure | LeftOut:
    """Draw stacked bars over cells."""
    name, title = "wire_cost", "What a message costs"
    how_to_read = (
        "A whole bar is the bytes on the wire for each byte of payload, both ways, with all headers; what stands above 1 is the "
        "price of the middleware, by what it was spent on."
    )
    if not info.panels:
        return LeftOut(name, title, "no run was recorded with --wire.")
    used = {part.name for parts in info.parts.values() for part in parts}
    return Figure(
        name,
        title,
        how_to_read,
        "wire_cost",
        facet_plan(
            info.facet,
            info.panels,
            names={name: label for name, label in PART_LABELS.items() if name in used},
            parts={str(group): parts for group, parts in info.parts.items()},
            incomplete=info.incomplete,
        ),
    )


FIGURE = figure_maker(wire_cost_info, wire_cost_figure)
