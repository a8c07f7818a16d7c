"""Latency that a bridge adds, with the interval of the difference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.analyzer.model.parameters import BRIDGED_COLUMNS
from dds_trace.tracefile.units.counts import counted

from ..book.groups import data_type_label
from ..book.numbers import whole_ns
from ..changes import received_words, runs_words
from .figure import Figure, LeftOut, figure_maker

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class Cost:
    """Difference of one statistic in ns, with the ends of its interval if the samples support them.

    Attributes:
        received: shares received in the same domain and through the bridge, as in `100.00% -> 98.50%`.
        runs: what the interval rests on, as in `5 and 5` or `1 and 1, within one run`.
    """

    difference_ns: int
    low_ns: int | None
    high_ns: int | None
    ratio: float | None
    verdict: str
    received: str
    runs: str


@dataclass(frozen=True, slots=True)
class BridgedCell:
    """One cell through one bridge.

    Attributes:
        group: index of the group through the bridge.
        costs: percentile (`p50` to `p99_9`) -> cost, for those that the samples support.
        bridge_cpu_percent: mean load of the bridge's processes during its runs, percent of one processor; None
            without samples.
    """

    group: int
    costs: Mapping[str, Cost]
    bridge_cpu_percent: float | None


@dataclass(frozen=True, slots=True)
class BridgePanel:
    """Bridged cells of one data type, sorted by cell, then series."""

    title: str
    cells: tuple[BridgedCell, ...]


@dataclass(frozen=True, slots=True)
class BridgeCost:
    """One panel per data type.

    Attributes:
        panels: panels with at least one cost.
        lost: groups through a bridge without any mark, because so much was lost that no percentile has a difference.
    """

    panels: tuple[BridgePanel, ...]
    lost: int = 0


def bridge_cost_info(book: Book) -> BridgeCost:
    """Assign the rows of `details.bridge_costs` to their groups."""
    groups = book.groups
    # The comparison pools the numbers of domains, so a row belongs to the first of the groups that differ in nothing else.
    place: dict[tuple[object, ...], int] = {}
    for index, row in enumerate(book.analysis.summary.iter_rows(named=True)):
        if row["domain_mode"] == "different":
            place.setdefault(tuple(row[name] for name in BRIDGED_COLUMNS), index)
    costs: dict[int, dict[str, Cost]] = {}
    compared: set[int] = set()
    for row in book.analysis.details.bridge_costs.iter_rows(named=True):
        group = place.get(tuple(row[name] for name in BRIDGED_COLUMNS))
        difference_ns = whole_ns(row["difference_ns"])
        if group is not None:
            compared.add(group)
        if group is not None and row["metric"] == "latency" and difference_ns is not None:
            ends = (whole_ns(row["difference_low_ns"]), whole_ns(row["difference_high_ns"]))
            costs.setdefault(group, {})[row["statistic"]] = Cost(
                difference_ns, *ends, row["ratio"], row["verdict"], received_words(row), runs_words(row)
            )
    loads = book.bridge_loads
    panels: dict[str, list[BridgedCell]] = {}
    for one in sorted(groups.groups, key=lambda group: (group.cell, group.series)):
        if one.index in costs:
            title = data_type_label(groups.cell_of(one).data_type)
            panels.setdefault(title, []).append(
                BridgedCell(one.index, costs[one.index], loads.get(one.index))
            )
    return BridgeCost(
        tuple(BridgePanel(title, tuple(cells)) for title, cells in panels.items()),
        len(compared - costs.keys()),
    )


def bridge_cost_figure(info: BridgeCost) -> Figure | LeftOut:
    """Draw marks with intervals over cells."""
    name, title = "bridge_cost", "What a bridge costs"
    how_to_read = (
        "Each mark is the latency through a bridge less that in the same domain, with its 95 % interval; an interval that "
        "reaches the zero line shows no difference that these samples can prove, and where a bridge loses many messages the "
        "share received is to be looked at first: a lost message is infinitely late"
        + (f"; {counted(info.lost, 'combination')} lost too much to have a mark." if info.lost else ".")
    )
    if not info.panels:
        return LeftOut(
            name,
            title,
            "no combination of data, size and rate has a latency both in the same and in different domains with all else equal.",
        )
    return Figure(name, title, how_to_read, "bridge_cost", {"panels": info.panels})


FIGURE = figure_maker(bridge_cost_info, bridge_cost_figure)
