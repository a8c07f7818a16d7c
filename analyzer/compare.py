"""Two sets of round trips against each other: per group and percentile the difference, how sure it is, a verdict.

Difference and ratio have an interval from the block bootstrap of both sides (`analyzer/intervals.py`); the effect is
the probability of superiority (R. McGraw and S. Wong, 1992; Cliff's delta, 1993, is twice that less one): how often a
message of the new side is faster than one of the base. One interval in twenty misses the truth by design: among many
groups a few verdicts are chance, which is why a gate (`analyzer/gates.py`) takes a limit and not "worse".

Runs of one group are taken as one series. What differs from run to run but not within a run (a reboot, another
channel) is in no interval that a single run can give: repeat runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from analyzer.columns import PARAMETER_NAMES
from analyzer.intervals import (
    REPLICATES,
    SEED,
    bootstrap_mean,
    bootstrap_quantile,
    dependence_of,
    quantile_of,
    ratio_interval,
)
from analyzer.sample_size import planned_messages
from analyzer.statistics import PERCENTILES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

MATCH_COLUMNS = tuple(
    name
    for name in PARAMETER_NAMES
    if name not in {"ping_device", "relay_device", "ping_domain_id", "relay_domain_id"}
)
"""What makes two groups the same experiment: every parameter but the machines' names and the domains' numbers."""

MEAN_NEEDS = 10
"""Independent messages below which a mean has no interval: the bootstrap of so few is far too narrow."""

QUANTILES = {p.name: p.quantile for p in PERCENTILES}


class Verdict(Enum):
    """What the interval of a ratio new / base says of a time, where less is better."""

    BETTER = "better"
    WORSE = "worse"
    SAME = "same"  # the whole interval is within the tolerance
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """How two sides are compared.

    Attributes:
        metrics: columns `<metric>_ns` to compare.
        statistics: `mean` and names of percentiles.
        match: columns that make two groups the same experiment.
        confidence: of every interval.
        same_within: a ratio wholly within `1 +- same_within` counts as the same.
        replicates: draws of the bootstrap.
    """

    metrics: tuple[str, ...] = ("latency", "rtt")
    statistics: tuple[str, ...] = ("mean", *QUANTILES)
    match: tuple[str, ...] = MATCH_COLUMNS
    confidence: float = 0.95
    same_within: float = 0.05
    replicates: int = REPLICATES


@dataclass(frozen=True, slots=True)
class Change:
    """One statistic of one group on both sides. Ends of intervals are None where a sample does not support them.

    Attributes:
        base: the statistic of the base, in ns; None if its sample is too small.
        new: the same of the new side, with `new_low` and `new_high`.
        difference: new - base, with `difference_low` and `difference_high`.
        ratio: new / base, with `ratio_low` and `ratio_high`.
    """

    base: float | None
    new: float | None
    new_low: float | None
    new_high: float | None
    difference: float | None
    difference_low: float | None
    difference_high: float | None
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None

    def verdict(self, same_within: float) -> Verdict:
        """Better, worse, the same, or not to be told from these samples."""
        if self.ratio_low is None or self.ratio_high is None:
            return Verdict.INCONCLUSIVE
        if 1 - same_within <= self.ratio_low and self.ratio_high <= 1 + same_within:
            return Verdict.SAME
        if self.ratio_high < 1:
            return Verdict.BETTER
        if self.ratio_low > 1:
            return Verdict.WORSE
        return Verdict.INCONCLUSIVE


def change_of(
    base: Int64 | Float64,
    new: Int64 | Float64,
    statistic: str,
    confidence: float = 0.95,
    replicates: int = REPLICATES,
) -> Change:
    """A statistic of two series (each in the order of time) and what can be said of its change.

    Args:
        base: values of the base.
        new: values of the new side.
        statistic: `mean` or the name of a percentile.
        confidence: of the intervals; an end is given only if both samples are worth enough messages for it.
        replicates: draws of the bootstrap.
    """
    before, after = (
        _side(values, statistic, confidence, replicates, SEED + i) for i, values in enumerate((base, new))
    )
    tail = [(1 - confidence) / 2, (1 + confidence) / 2]
    low = high = ratio_low = ratio_high = None
    if before.drawn is not None and after.drawn is not None:
        low, high = np.quantile(after.drawn - before.drawn, tail).tolist()
        if before.drawn.min() > 0:
            ratio_low, ratio_high = np.quantile(after.drawn / before.drawn, tail).tolist()
    new_low, new_high = (None, None) if after.drawn is None else np.quantile(after.drawn, tail).tolist()
    difference = ratio = None
    if before.value is not None and after.value is not None:
        difference = after.value - before.value
        ratio = after.value / before.value if before.value > 0 else None
    return Change(
        base=before.value,
        new=after.value,
        new_low=new_low,
        new_high=new_high,
        difference=difference,
        difference_low=low,
        difference_high=high,
        ratio=ratio,
        ratio_low=ratio_low,
        ratio_high=ratio_high,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """A statistic of one sample, and what the bootstrap makes of it; None where the sample is too small for it."""

    value: float | None
    drawn: Float64 | None


def _side(values: Int64 | Float64, statistic: str, confidence: float, replicates: int, seed: int) -> _Side:
    if statistic == "mean":
        if not len(values):
            return _Side(None, None)
        dependence = dependence_of(values)
        if len(values) / dependence.inflation < MEAN_NEEDS:
            return _Side(float(values.mean()), None)
        drawn = bootstrap_mean(values, dependence.block_messages, replicates=replicates, seed=seed)
        return _Side(float(values.mean()), drawn)
    percentile = next(p for p in PERCENTILES if p.name == statistic)
    if len(values) < percentile.needs:
        return _Side(None, None)
    value = quantile_of(np.sort(values), percentile.quantile)
    dependence = dependence_of(values <= value)
    if len(values) < planned_messages(percentile.quantile, confidence, dependence.inflation):
        return _Side(value, None)
    block = dependence.block_messages
    return _Side(
        value, bootstrap_quantile(values, percentile.quantile, block, replicates=replicates, seed=seed)
    )


def probability_of_superiority(base: Int64 | Float64, new: Int64 | Float64) -> float | None:
    """How often a value drawn from `new` is below one drawn from `base`, ties counted half; None without values.

    One half means no difference, 1 that every new message is faster than every one of the base.
    """
    if not len(base) or not len(new):
        return None
    ordered = np.sort(base)
    above = len(base) - np.searchsorted(ordered, new, side="right")
    ties = np.searchsorted(ordered, new, side="right") - np.searchsorted(ordered, new, side="left")
    return float((above + ties / 2).mean() / len(base))


COMPARISON_SCHEMA = {
    "metric": pl.String,
    "statistic": pl.String,
    "base_messages": pl.UInt64,
    "new_messages": pl.UInt64,
    "base_ns": pl.Float64,
    "new_ns": pl.Float64,
    "new_low_ns": pl.Float64,
    "new_high_ns": pl.Float64,
    "difference_ns": pl.Float64,
    "difference_low_ns": pl.Float64,
    "difference_high_ns": pl.Float64,
    "ratio": pl.Float64,
    "ratio_low": pl.Float64,
    "ratio_high": pl.Float64,
    "superiority": pl.Float64,
    "cliffs_delta": pl.Float64,
    "verdict": pl.String,
}


DELIVERY_SCHEMA = {
    f"{side}_{name}": dtype
    for side in ("base", "new")
    for name, dtype in {
        "published": pl.UInt64,
        "received_ratio": pl.Float64,
        "received_ratio_low": pl.Float64,
        "received_ratio_high": pl.Float64,
    }.items()
}


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What came of comparing two sides.

    Attributes:
        rows: one row per matched group, metric and statistic: the match columns, then `COMPARISON_SCHEMA` (times in
            ns; `superiority` and `cliffs_delta` are of the metric, not of the statistic; delta is positive where
            new is faster).
        delivery: one row per matched group: the match columns and for each side (`base_`, `new_`): `published` u64,
            `received_ratio`, `received_ratio_low`, `received_ratio_high` f64.
        only_base: groups (match columns) that the new side does not have.
        only_new: groups that the base does not have.
    """

    rows: pl.DataFrame
    delivery: pl.DataFrame
    only_base: pl.DataFrame
    only_new: pl.DataFrame
    options: CompareOptions


def compare_roundtrips(
    base: pl.DataFrame,
    new: pl.DataFrame,
    options: CompareOptions | None = None,
) -> Comparison:
    """Every group that both sides measured, compared.

    Args:
        base: frame of `docs/trace-format.md`.
        new: likewise.
        options: how; None for the defaults.
    """
    options = options or CompareOptions()
    rows: list[dict[str, Any]] = []
    delivery: list[dict[str, Any]] = []
    before, after = _groups(base, options.match), _groups(new, options.match)
    shared = [key for key in before if key in after]
    for key in shared:
        labels = dict(zip(options.match, key, strict=True))
        sides = {"base": before[key], "new": after[key]}
        delivery.append(
            labels | {k: v for side in sides for k, v in _delivery(side, sides[side], options).items()}
        )
        for metric in options.metrics:
            rows += (labels | row for row in _metric_rows(before[key], after[key], metric, options))
    label_schema = {name: base.schema[name] for name in options.match}
    return Comparison(
        rows=pl.DataFrame(rows, schema={**label_schema, **COMPARISON_SCHEMA}),
        delivery=pl.DataFrame(delivery, schema={**label_schema, **DELIVERY_SCHEMA}),
        only_base=_keys_frame([k for k in before if k not in after], label_schema),
        only_new=_keys_frame([k for k in after if k not in before], label_schema),
        options=options,
    )


def _groups(frame: pl.DataFrame, match: Sequence[str]) -> dict[tuple[Any, ...], pl.DataFrame]:
    """The frame's parts by the values of the match columns, sorted; messages in the order of time within a run."""
    ordered = frame.sort(*match, "run_id", "relay_id", "publish_ns", nulls_last=False)
    return {
        tuple(part.row(0, named=True)[name] for name in match): part
        for part in ordered.partition_by(*match, maintain_order=True)
    }


def _delivery(side: str, group: pl.DataFrame, options: CompareOptions) -> dict[str, Any]:
    ratio = ratio_interval((group["outcome"] == "completed").to_numpy(), options.confidence)
    return {
        f"{side}_published": len(group),
        f"{side}_received_ratio": ratio.value,
        f"{side}_received_ratio_low": ratio.lower,
        f"{side}_received_ratio_high": ratio.upper,
    }


def _metric_rows(
    base: pl.DataFrame,
    new: pl.DataFrame,
    metric: str,
    options: CompareOptions,
) -> Iterator[dict[str, Any]]:
    before, after = (side[f"{metric}_ns"].drop_nulls().to_numpy() for side in (base, new))
    superiority = probability_of_superiority(before, after)
    for statistic in options.statistics:
        change = change_of(before, after, statistic, options.confidence, options.replicates)
        yield {
            "metric": metric,
            "statistic": statistic,
            "base_messages": len(before),
            "new_messages": len(after),
            "base_ns": change.base,
            "new_ns": change.new,
            "new_low_ns": change.new_low,
            "new_high_ns": change.new_high,
            "difference_ns": change.difference,
            "difference_low_ns": change.difference_low,
            "difference_high_ns": change.difference_high,
            "ratio": change.ratio,
            "ratio_low": change.ratio_low,
            "ratio_high": change.ratio_high,
            "superiority": superiority,
            "cliffs_delta": None if superiority is None else 2 * superiority - 1,
            "verdict": change.verdict(options.same_within).value,
        }


def _keys_frame(keys: list[tuple[Any, ...]], schema: dict[str, Any]) -> pl.DataFrame:
    return pl.DataFrame(keys, schema=schema, orient="row")


BRIDGE_MATCH_COLUMNS = tuple(name for name in MATCH_COLUMNS if name not in {"domain_mode", "bridge"})


def bridge_cost(roundtrips: pl.DataFrame, options: CompareOptions | None = None) -> pl.DataFrame:
    """What communication between different domains costs against the same domain, for equal parameters.

    Returns:
        One row per bridge, group, metric and statistic: `bridge` str, then the columns of `Comparison.rows` (base is
        the same domain without a bridge, new is the way through the bridge), `base_received_ratio` and
        `new_received_ratio` f64.
    """
    options = options or CompareOptions()
    match = tuple(name for name in options.match if name in BRIDGE_MATCH_COLUMNS)
    same = roundtrips.filter((pl.col("domain_mode") == "same") & (pl.col("bridge") == "none"))
    different = roundtrips.filter(pl.col("domain_mode") == "different")
    how = replace(options, match=match)
    ratios = ["base_received_ratio", "new_received_ratio"]
    tables = []
    for bridge in [
        *different["bridge"].unique().sort(),
        None,
    ]:  # without any bridge the columns are there all the same
        found = compare_roundtrips(
            same, different.filter(pl.col("bridge").eq_missing(pl.lit(bridge, pl.String))), how
        )
        rows = found.rows.join(
            found.delivery.select(*match, *ratios),
            on=list(match),
            how="left",
            nulls_equal=True,
            maintain_order="left",
        )
        tables.append(rows.select(pl.lit(bridge, pl.String).alias("bridge"), pl.all()))
    return pl.concat(tables)
