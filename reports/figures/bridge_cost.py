"""What a bridge adds to the latency, as far as the samples can tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dds_trace.analyzer.model.parameters import BRIDGED_COLUMNS

from ..book.groups import data_type_label
from ..book.numbers import whole_ns
from .figure import Figure, LeftOut, figure_maker

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..book.book import Book


@dataclass(frozen=True, slots=True)
class Cost:
    """The difference of one statistic, ns, with the ends of its interval where the samples support them."""

    difference_ns: int
    low_ns: int | None
    high_ns: int | None
    ratio: float | None
    verdict: str


@dataclass(frozen=True, slots=True)
class BridgedCell:
    """One cell through one bridge.

    Attributes:
        group: the group through the bridge.
        costs: by percentile (`p50` to `p99_9`), those that the samples support.
        bridge_cpu_percent: mean load of the bridge's processes during its runs, of one processor; None if not sampled.
    """

    group: int
    costs: Mapping[str, Cost]
    bridge_cpu_percent: float | None


@dataclass(frozen=True, slots=True)
class BridgePanel:
    """The bridged cells of one data type, by cell, then series."""

    title: str
    cells: tuple[BridgedCell, ...]


@dataclass(frozen=True, slots=True)
class BridgeCost:
    """One panel per data type."""

    panels: tuple[BridgePanel, ...]


def bridge_cost_info(book: Book) -> BridgeCost:
    """The rows of `details.bridge_costs`, each at the groups that it was made of."""
    if book.analysis.details is None:
        return BridgeCost(())
    groups = book.groups
    # Devices are no part of the comparison: a row is drawn at the first of the groups that share all else.
    place: dict[tuple[Any, ...], int] = {}
    for index, row in enumerate(book.analysis.summary.iter_rows(named=True)):
        if row["domain_mode"] == "different":
            place.setdefault(tuple(row[name] for name in BRIDGED_COLUMNS), index)
    costs: dict[int, dict[str, Cost]] = {}
    for row in book.analysis.details.bridge_costs.iter_rows(named=True):
        group = place.get(tuple(row[name] for name in BRIDGED_COLUMNS))
        difference_ns = whole_ns(row["difference_ns"])
        if group is not None and row["metric"] == "latency" and difference_ns is not None:
            ends = (whole_ns(row["difference_low_ns"]), whole_ns(row["difference_high_ns"]))
            costs.setdefault(group, {})[row["statistic"]] = Cost(
                difference_ns, *ends, row["ratio"], row["verdict"]
            )
    loads = book.bridge_loads
    panels: dict[str, list[BridgedCell]] = {}
    for one in sorted(groups.groups, key=lambda group: (group.cell, group.series)):
        if one.index in costs:
            title = data_type_label(groups.cell_of(one).data_type)
            panels.setdefault(title, []).append(
                BridgedCell(one.index, costs[one.index], loads.get(one.index))
            )
    return BridgeCost(tuple(BridgePanel(title, tuple(cells)) for title, cells in panels.items()))


def bridge_cost_figure(info: BridgeCost) -> Figure | LeftOut:
    """Marks with intervals over cells."""
    name, title = "bridge_cost", "What a bridge costs"
    how_to_read = (
        "Each mark is the latency through a bridge less that in the same domain, with its 95 % interval; an interval that "
        "reaches the zero line shows no difference that these samples can prove, and where a bridge loses many messages the "
        "share received is to be looked at first, because only those that came back have a latency."
    )
    if not info.panels:
        return LeftOut(
            name,
            title,
            "no cell has a latency both in the same and in different domains with all else equal.",
        )
    return Figure(name, title, how_to_read, "bridge_cost", {"panels": info.panels})


FIGURE = figure_maker(bridge_cost_info, bridge_cost_figure)
