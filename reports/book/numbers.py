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
from dds_trace.base.units import counted, finite

from .groups import METRIC_LABELS, STATISTIC_LABELS, Groups
from .verdicts import VERDICTS, few_words, received_words, runs_words

Ends = Mapping[str, Mapping[str, tuple[int | None, ...]]]


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


def whole_ns(value_ns: float | None) -> int | None:
    return None if value_ns is None or not math.isfinite(value_ns) else round(value_ns)


@dataclass(frozen=True, slots=True)
class Intervals:
    """95 % intervals: metric -> percentile -> value per group, None without one."""

    low_ns: Ends
    high_ns: Ends
    episodes: Ends
    is_between: Ends
    runs: tuple[int, ...]

    def tail_episodes(self, metric: str, percentile: str, group: int) -> int | None:
        return _value(self.episodes, metric, percentile, group) if percentile != "p50" else None

    def ends(self, metric: str, percentile: str, group: int) -> tuple[int | None, int | None]:
        return _value(self.low_ns, metric, percentile, group), _value(self.high_ns, metric, percentile, group)

    def is_between_runs(self, metric: str, percentile: str, group: int) -> bool:
        return bool(_value(self.is_between, metric, percentile, group))

    def is_within_runs(self, metric: str, percentile: str, group: int) -> bool:
        return _value(self.is_between, metric, percentile, group) == 0

    def rests_on(self, metric: str, percentile: str, group: int) -> str:
        if _value(self.is_between, metric, percentile, group) is None:
            return ""
        within = "" if self.is_between_runs(metric, percentile, group) else f" ({few_words(self.runs[group])})"
        bursts = self.tail_episodes(metric, percentile, group)
        return f"rests on {counted(self.runs[group], 'run')}{within}" + (
            "" if bursts is None else f", {counted(bursts, 'burst')}"
        )


def _value(of_groups: Ends, metric: str, percentile: str, group: int) -> int | None:
    values = of_groups.get(metric, {}).get(percentile, ())
    return values[group] if values else None


def intervals_info(analysis: Analysis) -> Intervals:
    height = analysis.summary.height
    low, high, episodes, is_between = (
        {metric: dict[str, list[int | None]]() for metric in METRIC_LABELS} for _ in range(4)
    )
    runs = [0] * height
    columns = ("group", "metric", "percentile", "low_ns", "high_ns", "episodes", "runs", "basis")
    rows = analysis.details.intervals.select(columns).filter(pl.col("metric").is_in(list(METRIC_LABELS)))
    for group, metric, percentile, low_ns, high_ns, bursts, count, basis in rows.iter_rows():
        runs[group] = max(runs[group], count)
        for column, value in (
            (low, whole_ns(low_ns)),
            (high, whole_ns(high_ns)),
            (episodes, bursts),
            (is_between, int(basis == Basis.BETWEEN_RUNS.value)),
        ):
            column[metric].setdefault(percentile, [None] * height)[group] = value
    return Intervals(_frozen(low), _frozen(high), _frozen(episodes), _frozen(is_between), tuple(runs))


def _frozen(ends: Mapping[str, Mapping[str, list[int | None]]]) -> Ends:
    return {metric: {name: tuple(values) for name, values in columns.items()} for metric, columns in ends.items()}


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
    return Curves(LEVELS, values_ns, shares, tuple(map(_loss_text, lossy_shares(shares))))


def _loss_text(share: float | None) -> str:
    if share is None:
        return ""
    return "< 1 %" if 0 < share < 0.01 else f"{math.floor(100 * share)} %"


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
    """Return the groups with at least one cost, and how many lost too much for any."""
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
