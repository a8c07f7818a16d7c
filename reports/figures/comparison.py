"""Groups that sent the same messages side by side: vendors, and the same domain against different domains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.parameters import SAME_SIDES_COLUMNS
from dds_trace.tracefile.units.sizes import format_size

from ..book.groups import data_type_label
from .figure import Figure, LeftOut, Panel, cell_panels, figure_maker, panels_plan

if TYPE_CHECKING:
    from ..book.book import Book
    from ..book.groups import Groups, Series


@dataclass(frozen=True, slots=True)
class VendorComparison:
    """One panel per data type and domain mode; x is the rank of the cell in `Groups.cells`."""

    panels: tuple[Panel, ...]


def vendor_comparison_info(book: Book) -> VendorComparison:
    """Collect every group with a time, over its cell."""
    return VendorComparison(cell_panels(book.groups, book.values.timed))


def vendor_comparison_figure(info: VendorComparison) -> Figure | LeftOut:
    """Draw marks over cells: sizes, and within each size the rates."""
    name, title = "vendor_comparison", "Middlewares side by side, per data type"
    how_to_read = (
        "Marks above one another sent the same messages: the lowest took the least time, and every mark of the campaign "
        "is in this figure; times are those of the messages that came back."
    )
    if not info.panels:
        return LeftOut(name, title, "no message came back.")
    return Figure(name, title, how_to_read, "cells", panels_plan(info.panels, value="statistic"))


VENDOR_COMPARISON = figure_maker(vendor_comparison_info, vendor_comparison_figure)


@dataclass(frozen=True, slots=True)
class Pair:
    """Two groups that differ in the domain alone.

    Attributes:
        rate_hz: rate of both groups.
        same: index of the group in the same domain.
        different: index of the group across domains.
    """

    rate_hz: float
    same: int
    different: int


@dataclass(frozen=True, slots=True)
class PairPanel:
    """Pairs of one data type and size, by rate."""

    title: str
    pairs: tuple[Pair, ...]


@dataclass(frozen=True, slots=True)
class DomainDifference:
    """One panel per data type and size."""

    panels: tuple[PairPanel, ...]


def domain_pairs(groups: Groups) -> tuple[tuple[int, int], ...]:
    """Pair the groups of different domains with those of the same domain.

    Both groups have equal cell, vendors, devices and QoS. A group in the same domain belongs to several pairs if
    several bridges were measured.

    Returns:
        (group in the same domain, group in different domains), in the order of cells.
    """
    at_home = {
        (group.cell, _apart_from_domain(groups.series_of(group))): group.index
        for group in groups.groups
        if groups.series_of(group).domain_mode == "same" and groups.series_of(group).bridge == "none"
    }
    return tuple(
        (at_home[key], group.index)
        for group in sorted(groups.groups, key=lambda group: (group.cell, group.series))
        if groups.series_of(group).domain_mode == "different"
        and (key := (group.cell, _apart_from_domain(groups.series_of(group)))) in at_home
    )


def domain_difference_info(book: Book) -> DomainDifference:
    """Collect the pairs with times on both sides, in panels by data type and size."""
    groups, timed = book.groups, book.values.timed
    panels: dict[str, list[Pair]] = {}
    for same, different in domain_pairs(groups):
        if not timed(same) or not timed(different):
            continue
        cell = groups.cell_of(groups.groups[same])
        title = f"{data_type_label(cell.data_type)} {format_size(cell.payload_bytes)}"
        panels.setdefault(title, []).append(Pair(cell.rate_hz, same, different))
    return DomainDifference(tuple(PairPanel(title, tuple(pairs)) for title, pairs in panels.items()))


def domain_difference_figure(info: DomainDifference) -> Figure | LeftOut:
    """Draw grouped bars per rate."""
    name, title = "domain_difference", "Same domain against different domains"
    how_to_read = (
        "Plain bars stay in one domain, hatched bars cross to another through a bridge; the number above a hatched bar "
        "is what crossing cost the messages that came back."
    )
    if not info.panels:
        return LeftOut(
            name,
            title,
            "no combination of data, size and rate was measured both in the same and in different domains with all else equal.",
        )
    return Figure(name, title, how_to_read, "pairs", {"panels": info.panels})


DOMAIN_DIFFERENCE = figure_maker(domain_difference_info, domain_difference_figure)


def _apart_from_domain(series: Series) -> tuple[object, ...]:
    return series.values(SAME_SIDES_COLUMNS)
