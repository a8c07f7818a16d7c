"""How the values of a group are spread: from run to run, in the tail, and as the share of messages in time; latency over the plane of sizes and rates, a panel for each setup."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import polars as pl

from dds_trace.analyzer.statistics.intervals import Basis
from dds_trace.analyzer.statistics.percentiles import PERCENTILES

from ..book.book import Book
from ..book.groups import METRIC_LABELS, data_type_label
from .figure import Faceted, Figure, FigureMaker, LeftOut, Scope, facet_panels, facet_plan, plane_facet


@dataclass(frozen=True, slots=True)
class Spread(Faceted):
    """How far the 95 % interval of a typical run `reaches` to either side: percentile -> group -> share (0.05 is 5 %)."""

    reaches: Mapping[str, Mapping[int, float]]
    metric: str


def run_spread_info(book: Book, panels: str = "way", lines: str = "choice") -> Spread:
    metric = book.values.default_metric
    rows = book.analysis.details.intervals.filter(metric=metric, basis=Basis.BETWEEN_RUNS.value)
    reaches: dict[str, dict[int, float]] = {percentile.name: {} for percentile in PERCENTILES}
    columns = ("group", "percentile", "low_ns", "high_ns")
    for group, percentile, low_ns, high_ns in rows.select(columns).iter_rows():
        if low_ns and high_ns:
            reaches[percentile][group] = round(math.sqrt(high_ns / low_ns) - 1, 5)
    facet = plane_facet(book, panels, lines)
    drawn = {group for by_group in reaches.values() for group in by_group}
    return Spread(facet, facet_panels(book, facet, drawn.__contains__), reaches, metric)


def run_spread_figure(info: Spread) -> Figure | LeftOut:
    name, title = "run_spread", "Spread from run to run"
    if not info.panels:
        return LeftOut(name, title, "nothing was measured in three runs of its own.")
    how_to_read = (
        "Each mark is how far the 95 % interval of a typical run reaches to either side, in percent; a difference between two setups "
        "that is smaller than this needs more runs to be proved."
    )
    label = METRIC_LABELS[info.metric]
    plan = facet_plan(info.facet, info.panels, value="spread", reaches=info.reaches, label=label)
    return Figure(name, title, how_to_read, "lines", plan)


RUN_SPREAD = FigureMaker(run_spread_info, run_spread_figure, opened=False)


@dataclass(frozen=True, slots=True)
class DistributionCurves:
    """Whether any group has a curve; the page contains the curves once, for both figures."""

    any_drawn: bool


def distribution_info(book: Book) -> DistributionCurves:
    messages = book.analysis.distributions.group_by("group", "metric").agg(pl.sum("count"))["count"]
    return DistributionCurves(any(count > 1 for count in messages))


_NO_CURVE = "no result has two received messages."


def percentile_curve_figure(info: DistributionCurves) -> Figure | LeftOut:
    name, title = "percentile_curve", "Percentile curve"
    if not info.any_drawn:
        return LeftOut(name, title, _NO_CURVE)
    how_to_read = (
        "Each step to the right is ten times rarer: read off how late the worst message in 10, 100 or 1,000 of the received ones was; a "
        "curve ends where the sample does."
    )
    return Figure(name, title, how_to_read, "percentile_curve", {})


def ecdf_figure(info: DistributionCurves) -> Figure | LeftOut:
    name, title = "ecdf", "Share of messages in time (ECDF)"
    if not info.any_drawn:
        return LeftOut(name, title, _NO_CURVE)
    how_to_read = (
        "Pick a deadline on the horizontal axis: the curve shows which share of the planned messages met it; a lost or unsent message never "
        "does, so the curve ends at the share received; where that is less than all, a second curve is of the received messages."
    )
    return Figure(name, title, how_to_read, "ecdf", {})


PERCENTILE_CURVE = FigureMaker(distribution_info, percentile_curve_figure, Scope.CELL)
ECDF = FigureMaker(distribution_info, ecdf_figure, Scope.CELL)


@dataclass(frozen=True, slots=True)
class HeatmapPanel:
    """Plane of one setup and data type; `tiles` are (payload in bytes, rate in Hz, group) of what was measured."""

    title: str
    tiles: tuple[tuple[int, float, int], ...]


@dataclass(frozen=True, slots=True)
class Heatmap:
    panels: tuple[HeatmapPanel, ...]


def heatmap_info(book: Book) -> Heatmap:
    groups = book.groups
    planes: dict[tuple[str, int], list[tuple[int, float, int]]] = {}
    for group in groups.in_order:
        cell = groups.cell_of(group)
        tile = (cell.payload_bytes, cell.rate_hz, group.index)
        planes.setdefault((cell.data_type, group.series), []).append(tile)
    return Heatmap(
        tuple(
            HeatmapPanel(f"{data_type_label(data_type)}: {groups.labels[series]}", tuple(tiles))
            for (data_type, series), tiles in planes.items()
            if len(tiles) > 1
        )
    )


def heatmap_figure(info: Heatmap) -> Figure | LeftOut:
    name, title = "heatmap", "Size by rate, a panel for each setup"
    how_to_read = "Each tile is one size (upwards) at one rate (to the right), all panels on one colour scale; an empty tile was not measured."
    if not info.panels:
        return LeftOut(name, title, "no data type was measured at two sizes or rates with one setup.")
    return Figure(name, title, how_to_read, "heatmap", {"panels": info.panels})


HEATMAP = FigureMaker(heatmap_info, heatmap_figure, opened=False, few=False)
