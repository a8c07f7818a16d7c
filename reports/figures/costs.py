"""What a bridge, other flows and a load cost: ratios, a few groups in one chart, and the same messages in one domain and across domains."""

from __future__ import annotations

from collections.abc import Mapping

from dds_trace.analyzer.groups.report_values import planned_percentiles
from dds_trace.analyzer.model.parameters import SAME_SIDES_COLUMNS
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.base.units import counted

from ..book.book import Book
from ..book.groups import STATISTIC_LABELS, Groups
from ..book.numbers import BridgedCell, Cost, cost_of
from ..book.verdicts import share_words
from .figure import FEW_GROUPS, Facet, FigureMaker, Plan, is_few, spread_plan


def bridge_cost_plan(book: Book) -> Plan | None:
    cells, lost = book.bridge_costs
    return _costs_plan(book, cells, f"{counted(lost, 'result')} lost too much to have a mark." if lost else "")


_INSTEAD = {
    name: "p99" if name == "max" else "p50"
    for name in STATISTIC_LABELS
    if name not in {percentile.name for percentile in PERCENTILES}
}
"""Statistic -> the percentile that is compared in its place."""


def _costs_plan(book: Book, cells: Mapping[int, BridgedCell], foot: str = "") -> Plan | None:
    facet = Facet("plane", "place")
    return spread_plan(book, facet, cells.__contains__, cells=cells, instead=_INSTEAD, foot=foot)


BRIDGE_COST = FigureMaker(
    name="bridge_cost",
    title="What a bridge costs",
    how_to_read=(
        "Each mark is how many times as long a message takes through a bridge as in the same domain, with its 95 % interval and "
        "the difference; an interval that reaches the line shows no difference that these samples can prove; a lost message counts as "
        "later than any deadline."
    ),
    nothing="no message has a latency both in the same and in different domains with all else equal.",
    kind="bridge_cost",
    make=bridge_cost_plan,
)


def interference_plan(book: Book) -> Plan | None:
    costs: dict[int, dict[str, Cost]] = {}
    for row in book.analysis.details.interference.iter_rows(named=True):
        if (cost := cost_of(row)) is not None:
            costs.setdefault(row["group"], {})[row["statistic"]] = cost
    return _costs_plan(book, {group: BridgedCell(values, None) for group, values in costs.items()})


INTERFERENCE = FigureMaker(
    name="interference",
    title="What other flows and loads cost",
    how_to_read=(
        "Each mark is how many times as long a message takes with the other flows or the load that its setting names as without, with its "
        "95 % interval and the difference; an interval that reaches the line shows no difference that these samples can prove."
    ),
    nothing="nothing was recorded both with and without other flows, or a load.",
    kind="bridge_cost",
    make=interference_plan,
)


def dots_plan(book: Book) -> Plan | None:
    groups = [group.index for group in book.groups.in_order if group.published]
    if not is_few(book) or not any(map(book.values.timed, groups)):
        return None
    return {"groups": groups, "cells": book.bridge_costs[0]}


DOTS = FigureMaker(
    name="dots",
    title="Latency at a glance",
    how_to_read="Each line is one result: the mark is its time with the 95 % interval; times are of the received messages.",
    nothing=f"no message was received, or there are more than {FEW_GROUPS} results.",
    kind="dots",
    make=dots_plan,
    follows=True,
)


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


def domain_difference_plan(book: Book) -> Plan | None:
    published = book.values.plain["published"]
    pairs = [pair for pair in domain_pairs(book.groups) if all(published[group] for group in pair)]
    paired = {group for pair in pairs for group in pair}
    planned = planned_percentiles(book.analysis.summary, book.analysis.distributions)
    shares = book.values.plain["received_ratio"]
    received = {other: share_words(shares[same], shares[other]) for same, other in pairs}
    facet = Facet("size", "rate")
    return spread_plan(book, facet, paired.__contains__, pairs=pairs, planned=planned, received=received)


DOMAIN_DIFFERENCE = FigureMaker(
    name="domain_difference",
    title="Latency in the same domain against different domains",
    how_to_read=(
        "Full bars stay in one domain, pale bars next to them cross to another through a bridge; bars are over the planned messages: "
        "a lost message counts as later than any deadline, and a bar that reaches the top lost too many."
    ),
    nothing="no message was measured both in the same and in different domains with all else equal.",
    kind="bars",
    make=domain_difference_plan,
    opened=False,
    few=False,
    follows=True,
)
