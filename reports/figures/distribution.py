"""How the values of a group are spread: from run to run, in the tail, and as the share of messages in time; latency over the plane of sizes and rates, a panel for each setup."""

from __future__ import annotations

import math
from dataclasses import dataclass

import polars as pl

from dds_trace.analyzer.statistics.intervals import Basis
from dds_trace.analyzer.statistics.percentiles import PERCENTILES

from ..book.book import Book
from ..book.groups import METRIC_LABELS, data_type_label
from .figure import FigureMaker, Plan, Scope, plane_facet, spread_plan


def run_reaches(book: Book) -> dict[str, dict[int, float]]:
    """Percentile -> group -> how far the 95 % interval of a typical run reaches to either side (0.05 is 5 %)."""
    rows = book.analysis.details.intervals.filter(metric=book.values.default_metric, basis=Basis.BETWEEN_RUNS.value)
    reaches: dict[str, dict[int, float]] = {percentile.name: {} for percentile in PERCENTILES}
    columns = ("group", "percentile", "low_ns", "high_ns")
    for group, percentile, low_ns, high_ns in rows.select(columns).iter_rows():
        if low_ns and high_ns:
            reaches[percentile][group] = round(math.sqrt(high_ns / low_ns) - 1, 5)
    return reaches


def run_spread_plan(book: Book) -> Plan | None:
    reaches, label = run_reaches(book), METRIC_LABELS[book.values.default_metric]
    drawn = {group for by_group in reaches.values() for group in by_group}
    facet = plane_facet(book, "way", "choice")
    return spread_plan(book, facet, drawn.__contains__, value="spread", reaches=reaches, label=label)


RUN_SPREAD = FigureMaker(
    name="run_spread",
    title="Spread from run to run",
    how_to_read=(
        "Each mark is how far the 95 % interval of a typical run's received messages reaches to either side; a difference between two setups "
        "that is smaller than this needs more runs to be proved."
    ),
    nothing="nothing was measured in three runs of its own.",
    make=run_spread_plan,
    opened=False,
)


def distribution_plan(book: Book) -> Plan | None:
    """The page contains the curves once, for both figures."""
    messages = book.analysis.distributions.group_by("group", "metric").agg(pl.sum("count"))["count"]
    return {} if any(count > 1 for count in messages) else None


_NO_CURVE = "no result has two received messages."

PERCENTILE_CURVE = FigureMaker(
    name="percentile_curve",
    title="Percentile curve",
    how_to_read=(
        "Each step to the right is ten times rarer: the time that one received message in 10, 100 or 1,000 exceeds; a curve ends where "
        "the sample does."
    ),
    nothing=_NO_CURVE,
    kind="percentile_curve",
    make=distribution_plan,
    scope=Scope.CELL,
)
ECDF = FigureMaker(
    name="ecdf",
    title="Share of messages in time (ECDF)",
    how_to_read=(
        "A curve is the share of the planned messages that met each deadline; a lost or unsent message never does, so it ends at the "
        "share received."
    ),
    nothing=_NO_CURVE,
    kind="ecdf",
    make=distribution_plan,
    scope=Scope.CELL,
)


@dataclass(frozen=True, slots=True)
class HeatmapPanel:
    """Plane of one setup and data type; `tiles` are (payload in bytes, rate in Hz, group) of what was measured."""

    title: str
    tiles: tuple[tuple[int, float, int], ...]


def heatmap_plan(book: Book) -> Plan | None:
    groups = book.groups
    planes: dict[tuple[str, int], list[tuple[int, float, int]]] = {}
    for group in groups.in_order:
        cell = groups.cell_of(group)
        tile = (cell.payload_bytes, cell.rate_hz, group.index)
        planes.setdefault((cell.data_type, group.series), []).append(tile)
    panels = [
        HeatmapPanel(f"{data_type_label(data_type)}: {groups.labels[series]}", tuple(tiles))
        for (data_type, series), tiles in planes.items()
        if len(tiles) > 1
    ]
    return {"panels": panels} if panels else None


HEATMAP = FigureMaker(
    name="heatmap",
    title="Size by rate, a panel for each setup",
    how_to_read="Each tile is one size (upwards) at one rate (to the right), all panels on one colour scale; an empty tile was not measured.",
    nothing="no data type was measured at two sizes or rates with one setup.",
    kind="heatmap",
    make=heatmap_plan,
    opened=False,
    few=False,
)
