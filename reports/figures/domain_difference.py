"""The same messages in the same domain and across domains, as bars side by side."""

from __future__ import annotations

from dataclasses import dataclass

from dds_trace.analyzer.groups.report_values import Planned, planned_percentiles
from dds_trace.analyzer.model.parameters import SAME_SIDES_COLUMNS

from ..book.book import Book
from ..book.groups import Groups
from .figure import Facet, Faceted, Figure, FigureMaker, LeftOut, facet_panels, facet_plan


@dataclass(frozen=True, slots=True)
class DomainDifference(Faceted):
    pairs: tuple[tuple[int, int], ...]
    planned: Planned


def domain_pairs(groups: Groups) -> tuple[tuple[int, int], ...]:
    """Pair each group across domains with the one in the same domain that differs in nothing else, by cell."""
    ordered = [(group, groups.series_of(group)) for group in groups.in_order]
    keyed = [((group.cell, series.values(SAME_SIDES_COLUMNS)), group, series) for group, series in ordered]
    same = {
        key: group.index for key, group, series in keyed if series.domain_mode == "same" and series.bridge == "none"
    }
    return tuple(
        (same[key], group.index) for key, group, series in keyed if series.domain_mode == "different" and key in same
    )


def domain_difference_info(
    book: Book, panels: str = "rate", lines: str = "choice", x: str = "size"
) -> DomainDifference:
    published = book.values.plain["published"]
    pairs = tuple(pair for pair in domain_pairs(book.groups) if all(published[group] for group in pair))
    paired = {group for pair in pairs for group in pair}
    facet = Facet(x, panels, lines)
    planned = planned_percentiles(book.analysis.summary, book.analysis.distributions)
    return DomainDifference(facet, facet_panels(book, facet, paired.__contains__), pairs, planned)


def domain_difference_figure(info: DomainDifference) -> Figure | LeftOut:
    name, title = "domain_difference", "Latency in the same domain against different domains"
    how_to_read = (
        "Full bars stay in one domain, pale bars next to them cross to another through a bridge; bars are over the planned messages: "
        "a lost message is infinitely late, and a bar that reaches the top lost too many."
    )
    if not info.panels:
        nothing = "no message was measured both in the same and in different domains with all else equal."
        return LeftOut(name, title, nothing)
    planned = {str(group): times for group, times in info.planned.items()}
    plan = facet_plan(info.facet, info.panels, pairs=info.pairs, planned=planned)
    return Figure(name, title, how_to_read, "bars", plan, follows=True)


FIGURE = FigureMaker(domain_difference_info, domain_difference_figure, opened=False, few=False)
