"""Groups that sent the same messages side by side: vendors, places, and the same domain against different domains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.parameters import SAME_SIDES_COLUMNS

from ..book.numbers import Planned, planned_percentiles
from .figure import (
    Facet,
    Faceted,
    Figure,
    LeftOut,
    Panel,
    facet_panels,
    facet_plan,
    faceted,
    faceted_lines,
    figure_maker,
)

if TYPE_CHECKING:
    from ..book.book import Book
    from ..book.groups import Groups, Series


def vendor_comparison_info(book: Book, panels: str = "way", lines: str = "choice") -> Faceted:
    """Collect every group with a time, over its cell; x is the rank of the cell in `Groups.cells`."""
    return faceted(book, Facet("plane", panels, lines), book.values.timed)


def vendor_comparison_figure(info: Faceted) -> Figure | LeftOut:
    """Draw marks over cells: sizes, and within each size the rates."""
    name, title = "vendor_comparison", "Latency side by side, all combinations"
    how_to_read = (
        "Marks above one another sent the same messages: the lowest took the least time, and every mark of the campaign "
        "is in this figure; times are those of the messages that came back."
    )
    if not info.panels:
        return LeftOut(name, title, "no message came back.")
    plan = facet_plan(info.facet, info.panels, value="statistic")
    return Figure(name, title, how_to_read, "lines", plan, follows=True)


VENDOR_COMPARISON = figure_maker(vendor_comparison_info, vendor_comparison_figure, opened=False, few=False)


def by_device_info(book: Book, panels: str = "size", lines: str = "choice") -> Faceted:
    """Collect every group with a time that was measured on other devices or links, too; x is the option of `place`."""
    return faceted_lines(book, Facet("place", panels, lines), book.values.timed)


def by_device_figure(info: Faceted) -> Figure | LeftOut:
    """Draw marks over devices and links."""
    name, title = "by_device", "Latency by devices and link"
    if not info.panels:
        return LeftOut(name, title, "everything was measured on the same devices and link.")
    how_to_read = (
        "Marks of one colour sent the same messages on other devices or another link; where their order changes from place to "
        "place, what wins on one device does not win on the other."
    )
    plan = facet_plan(info.facet, info.panels, value="statistic")
    return Figure(name, title, how_to_read, "lines", plan, follows=True)


BY_DEVICE = figure_maker(by_device_info, by_device_figure, opened=False, few=False)


@dataclass(frozen=True, slots=True)
class DomainDifference:
    """Pairs of groups that differ in the domain alone, as bars.

    Attributes:
        panels: bars of the groups of all pairs; x is the size in bytes or the rate in Hz.
        pairs: (group in the same domain, group across domains).
        planned: percentiles of lossy groups over the messages planned.
    """

    facet: Facet
    panels: tuple[Panel, ...]
    pairs: tuple[tuple[int, int], ...]
    planned: Planned


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


def domain_difference_info(
    book: Book, panels: str = "rate", lines: str = "choice", x: str = "size"
) -> DomainDifference:
    """Collect the pairs of which a message was published on both sides."""
    published = book.values.plain["published"]
    pairs = tuple(pair for pair in domain_pairs(book.groups) if all(published[group] for group in pair))
    paired = {group for pair in pairs for group in pair}
    facet = Facet(x, panels, lines)
    return DomainDifference(
        facet, facet_panels(book, facet, paired.__contains__), pairs, planned_percentiles(book.analysis)
    )


def domain_difference_figure(info: DomainDifference) -> Figure | LeftOut:
    """Draw bars beside one another."""
    name, title = "domain_difference", "Latency in the same domain against different domains"
    how_to_read = (
        "Plain bars stay in one domain, hatched bars beside them cross to another through a bridge; bars are of the messages "
        "planned, so that one that was lost is infinitely late and a bar that reaches the top lost too many."
    )
    if not info.panels:
        return LeftOut(
            name,
            title,
            "no combination of data, size and rate was measured both in the same and in different domains with all else equal.",
        )
    planned = {str(group): of_group for group, of_group in info.planned.items()}
    plan = facet_plan(info.facet, info.panels, pairs=info.pairs, planned=planned)
    return Figure(name, title, how_to_read, "bars", plan, follows=True)


DOMAIN_DIFFERENCE = figure_maker(domain_difference_info, domain_difference_figure, few=False)


def _apart_from_domain(series: Series) -> tuple[object, ...]:
    return series.values(SAME_SIDES_COLUMNS)
