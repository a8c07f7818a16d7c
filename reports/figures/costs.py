"""What a bridge, other flows and a load cost: ratios, a few groups in one chart, and the same messages in one domain and across domains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dds_trace.analyzer.groups.report_values import Planned, planned_percentiles
from dds_trace.analyzer.model.parameters import SAME_SIDES_COLUMNS
from dds_trace.base.units import counted

from ..book.book import Book
from ..book.groups import Groups
from ..book.numbers import BridgedCell, Cost, cost_of
from .figure import FEW_GROUPS, Facet, Faceted, Figure, FigureMaker, LeftOut, facet_panels, facet_plan, is_few


@dataclass(frozen=True, slots=True)
class BridgeCost(Faceted):
    """Groups with at least one cost; `lost` are those that lost too much for any."""

    cells: Mapping[int, BridgedCell]
    lost: int = 0


def bridge_cost_info(book: Book) -> BridgeCost:
    cells, lost = book.bridge_costs
    facet = Facet("plane", "place")
    return BridgeCost(facet, facet_panels(book, facet, cells.__contains__), cells, lost)


def bridge_cost_figure(info: BridgeCost) -> Figure | LeftOut:
    name, title = "bridge_cost", "What a bridge costs"
    how_to_read = (
        "Each mark is how many times as long a message takes through a bridge as in the same domain, with its 95 % interval and "
        "the difference; an interval that reaches the line shows no difference that these samples can prove; where a bridge loses many "
        "messages look at the share received first: a lost message is infinitely late"
        + (f"; {counted(info.lost, 'result')} lost too much to have a mark." if info.lost else ".")
    )
    if not info.panels:
        reason = "no message has a latency both in the same and in different domains with all else equal."
        return LeftOut(name, title, reason)
    return Figure(name, title, how_to_read, "bridge_cost", facet_plan(info.facet, info.panels, cells=info.cells))


BRIDGE_COST = FigureMaker(bridge_cost_info, bridge_cost_figure, few=False)


def interference_info(book: Book) -> BridgeCost:
    costs: dict[int, dict[str, Cost]] = {}
    for row in book.analysis.details.interference.iter_rows(named=True):
        if (cost := cost_of(row)) is not None:
            costs.setdefault(row["group"], {})[row["statistic"]] = cost
    cells = {group: BridgedCell(values, None) for group, values in costs.items()}
    facet = Facet("plane", "place")
    return BridgeCost(facet, facet_panels(book, facet, cells.__contains__), cells)


def interference_figure(info: BridgeCost) -> Figure | LeftOut:
    name, title = "interference", "What other flows and loads cost"
    how_to_read = (
        "Each mark is how many times as long a message takes with the other flows or the load that its setting names as without, with its "
        "95 % interval and the difference; an interval that reaches the line shows no difference that these samples can prove."
    )
    if not info.panels:
        return LeftOut(name, title, "nothing was recorded both with and without other flows, or a load.")
    return Figure(name, title, how_to_read, "bridge_cost", facet_plan(info.facet, info.panels, cells=info.cells))


INTERFERENCE = FigureMaker(interference_info, interference_figure)


@dataclass(frozen=True, slots=True)
class Dots:
    groups: tuple[int, ...]
    cells: Mapping[int, BridgedCell]


def dots_info(book: Book) -> Dots:
    groups = book.groups.in_order
    if not is_few(book) or not any(book.values.timed(group.index) for group in groups):
        return Dots((), {})
    return Dots(tuple(group.index for group in groups if group.published), bridge_cost_info(book).cells)


def dots_figure(info: Dots) -> Figure | LeftOut:
    name, title = "dots", "Latency at a glance"
    if not info.groups:
        return LeftOut(name, title, f"no message was received, or there are more than {FEW_GROUPS} results.")
    how_to_read = (
        "Each line is one result: the dot is its time with the 95 % interval, followed by the share received and how many times as long a "
        "message takes through a bridge as in the same domain; times are of the received messages."
    )
    return Figure(name, title, how_to_read, "dots", {"groups": info.groups, "cells": info.cells}, follows=True)


DOTS = FigureMaker(dots_info, dots_figure)


@dataclass(frozen=True, slots=True)
class DomainDifference(Faceted):
    pairs: tuple[tuple[int, int], ...]
    planned: Planned


def domain_pairs(groups: Groups) -> tuple[tuple[int, int], ...]:
    """Pair each group across domains with the one in the same domain that differs in nothing else, by cell."""
    ordered = [(group, groups.series_of(group)) for group in groups.in_order]
    keyed = [((group.cell, series.of(SAME_SIDES_COLUMNS)), group, series) for group, series in ordered]
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
    plan = facet_plan(info.facet, info.panels, pairs=info.pairs, planned=info.planned)
    return Figure(name, title, how_to_read, "bars", plan, follows=True)


DOMAIN_DIFFERENCE = FigureMaker(domain_difference_info, domain_difference_figure, opened=False, few=False)
