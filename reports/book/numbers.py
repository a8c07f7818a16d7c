"""Numbers of the groups as figures and tables look them up."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.groups.report_values import LEVELS, curves, planned_shares, sustained_shares
from dds_trace.analyzer.model.parameters import BRIDGED_COLUMNS
from dds_trace.analyzer.statistics.intervals import Basis
from dds_trace.analyzer.verdicts.judgements import lossy_shares
from dds_trace.base.units import counted, finite, format_ratio

from .groups import METRIC_LABELS, STATISTIC_LABELS, Groups
from .verdicts import VERDICTS, few_words, received_words, runs_words

PLAIN_COLUMNS = (
    *("received_ratio", "achieved_rate_hz", "transfer_rate_bytes_per_s", "own_cost_ns", "own_share"),
    *("published", "received", "lost_outbound", "lost_in_relay", "lost_return", "lost_unknown"),
    *("duplicates", "reordered", "runs", "planned", "unsent"),
)


@dataclass(frozen=True, slots=True)
class Values:
    """Numbers of `summary`: item i of each tuple is group i's, None without a value."""

    times_ns: Mapping[str, Mapping[str, tuple[int | None, ...]]]
    plain: Mapping[str, tuple[float | None, ...]]

    def has(self, metric: str) -> bool:
        return any(value is not None for column in self.times_ns[metric].values() for value in column)

    def timed(self, group: int) -> bool:
        return any(columns["max"][group] is not None for columns in self.times_ns.values())

    @property
    def default_metric(self) -> str:
        return next((metric for metric in METRIC_LABELS if self.has(metric)), "latency")


def values_info(analysis: Analysis) -> Values:
    summary = analysis.summary
    return Values(
        times_ns={
            metric: {
                name: tuple(whole_ns(value) for value in summary[f"{metric}_{name}_ns"]) for name in STATISTIC_LABELS
            }
            for metric in METRIC_LABELS
        },
        plain={
            **{name: tuple(finite(value) for value in summary[name]) for name in PLAIN_COLUMNS},
            "received_ratio": planned_shares(summary),
            "sustained": tuple(map(finite, sustained_shares(summary))),
        },
    )


TYPICAL_RUN, ALL_MESSAGES = "a typical run", "all messages"


@dataclass(frozen=True, slots=True)
class Median:
    """Infinite where the median message is lost."""

    ns: float
    of: str
    p99_ns: float | None = None


def shown_medians(analysis: Analysis, groups: Groups, values: Values) -> dict[int, Median]:
    details, metric = analysis.details, values.default_metric
    label = METRIC_LABELS[metric].lower()
    between = {"metric": metric, "basis": Basis.BETWEEN_RUNS.value}
    rows = details.intervals.filter(**between).select("percentile", "group", "typical_ns").iter_rows()
    typical_ns = {(percentile, group): time_ns for percentile, group, time_ns in rows}
    with_losses_ns = {
        group: setup.p50_ns
        for answer in (details.answers if metric == "latency" else ())
        for setup in answer.contenders
        if setup.latency.basis is Basis.BETWEEN_RUNS
        for group in setup.groups
    }
    medians = {}
    for group in groups.groups:
        is_whole = group.received == group.published and not values.plain["unsent"][group.index]
        run_ns = typical_ns.get(("p50", group.index)) if is_whole else with_losses_ns.get(group.index)
        all_ns, all_p99_ns = (values.times_ns[metric][name][group.index] for name in ("p50", "p99"))
        if run_ns is not None:
            p99_ns = typical_ns.get(("p99", group.index)) if is_whole else None
            medians[group.index] = Median(run_ns, f"{label} of {TYPICAL_RUN}", p99_ns)
        elif all_ns is not None:
            medians[group.index] = Median(
                all_ns, f"{label} of all {'' if is_whole else 'received '}messages", all_p99_ns
            )
    return medians


def whole_ns(value_ns: float | None) -> int | None:
    return None if value_ns is None or not math.isfinite(value_ns) else round(value_ns)


@dataclass(frozen=True, slots=True)
class Intervals:
    """Metric -> percentile -> group -> row of `Details.intervals`, its ends in whole ns."""

    rows: Mapping[str, Mapping[str, Mapping[int, Mapping[str, Any]]]]

    def row(self, metric: str, percentile: str, group: int) -> Mapping[str, Any] | None:
        return self.rows.get(metric, {}).get(percentile, {}).get(group)

    def tail_episodes(self, metric: str, percentile: str, group: int) -> int | None:
        row = self.row(metric, percentile, group)
        return None if row is None or percentile == "p50" else row["episodes"]

    def ends(self, metric: str, percentile: str, group: int) -> tuple[int | None, int | None]:
        row = self.row(metric, percentile, group)
        return (None, None) if row is None else (row["low_ns"], row["high_ns"])

    def typical(self, metric: str, percentile: str, group: int) -> int | None:
        row = self.row(metric, percentile, group)
        is_between = row is not None and row["basis"] == Basis.BETWEEN_RUNS.value
        return whole_ns(row["typical_ns"]) if row and is_between else None

    def is_within_runs(self, metric: str, percentile: str, group: int) -> bool:
        row = self.row(metric, percentile, group)
        return row is not None and row["basis"] == Basis.WITHIN_RUN.value

    def rests_on(self, metric: str, percentile: str, group: int) -> str:
        row = self.row(metric, percentile, group)
        if row is None:
            return ""
        within = f" ({few_words(row['runs'])})" if self.is_within_runs(metric, percentile, group) else ""
        bursts = self.tail_episodes(metric, percentile, group)
        return f"rests on {counted(row['runs'], 'run')}{within}" + (
            "" if bursts is None else f", {counted(bursts, 'burst')}"
        )


def intervals_info(analysis: Analysis) -> Intervals:
    rows: dict[str, dict[str, dict[int, Mapping[str, Any]]]] = {metric: {} for metric in METRIC_LABELS}
    for row in analysis.details.intervals.filter(pl.col("metric").is_in(list(rows))).iter_rows(named=True):
        ends = {name: whole_ns(row[name]) for name in ("low_ns", "high_ns")}
        rows[row["metric"]].setdefault(row["percentile"], {})[row["group"]] = row | ends
    return Intervals(rows)


@dataclass(frozen=True, slots=True)
class Curves:
    """Metric -> for each group the times at the first levels; `losses` are of those that a figure marks."""

    levels: tuple[float, ...]
    values_ns: Mapping[str, tuple[tuple[int, ...], ...]]
    shares: tuple[float | None, ...] = ()
    losses: tuple[str, ...] = ()


def curves_info(analysis: Analysis) -> Curves:
    drawn, groups = curves(analysis.distributions), range(analysis.summary.height)
    values_ns = {metric: tuple(drawn.get((group, metric), ()) for group in groups) for metric in METRIC_LABELS}
    shares = planned_shares(analysis.summary)
    losses = tuple("" if share is None else format_ratio(share) for share in lossy_shares(shares))
    return Curves(LEVELS, values_ns, shares, losses)


@dataclass(frozen=True, slots=True)
class Cost:
    """Difference of one statistic in ns and its ratio, with their intervals and what these rest on."""

    difference_ns: int
    low_ns: int | None
    high_ns: int | None
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None
    verdict: str
    received: str
    runs: str


@dataclass(frozen=True, slots=True)
class BridgedCell:
    costs: Mapping[str, Cost]
    bridge_cpu_percent: float | None


def cost_of(row: Mapping[str, Any]) -> Cost | None:
    difference_ns = whole_ns(row["difference_ns"])
    if difference_ns is None:
        return None
    low_ns, high_ns = whole_ns(row["difference_low_ns"]), whole_ns(row["difference_high_ns"])
    ratios = (finite(row[name]) for name in ("ratio", "ratio_low", "ratio_high"))
    ratio, low, high = (None if value is None else round(value, 4) for value in ratios)
    verdict = VERDICTS[row["verdict"]]
    return Cost(difference_ns, low_ns, high_ns, ratio, low, high, verdict, received_words(row), runs_words(row))


def bridge_costs(
    analysis: Analysis, groups: Groups, loads: Mapping[int, float]
) -> tuple[Mapping[int, BridgedCell], int]:
    # The comparison pools domain ids, so a row belongs to the first of several groups.
    first: dict[tuple[object, ...], int] = {}
    for index, row in enumerate(analysis.summary.iter_rows(named=True)):
        if row["domain_mode"] == "different":
            first.setdefault(tuple(row[name] for name in BRIDGED_COLUMNS), index)
    costs: dict[int, dict[str, Cost]] = {}
    compared: set[int] = set()
    for row in analysis.details.bridge_costs.iter_rows(named=True):
        group = first.get(tuple(row[name] for name in BRIDGED_COLUMNS))
        if group is None:
            continue
        compared.add(group)
        if row["metric"] == "latency" and (cost := cost_of(row)) is not None:
            costs.setdefault(group, {})[row["statistic"]] = cost
    ordered = (group.index for group in groups.in_order)
    cells = {group: BridgedCell(costs[group], loads.get(group)) for group in ordered if group in costs}
    return cells, len(compared - costs.keys())
