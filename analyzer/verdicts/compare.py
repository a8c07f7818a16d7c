"""Two sets of round trips against each other: per group and percentile the difference, how sure it is, a verdict.

Difference and ratio have an interval from the block bootstrap of both sides (`analyzer/statistics/intervals.py`); the effect is
the probability of superiority (R. McGraw and S. Wong, 1992; Cliff's delta, 1993, is twice that less one): how often a
message of the new side is faster than one of the base. One interval in twenty misses the truth by design: among many
groups a few verdicts are chance, which is why a gate (`analyzer/verdicts/gates.py`) takes a limit and not "worse".

Runs of one group are taken as one series. What differs from run to run but not within a run (a reboot, another
channel) is in no interval that a single run can give: repeat runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import polars as pl

from ..model.parameters import BRIDGE_MATCH_COLUMNS, MATCH_COLUMNS
from ..statistics.bootstrap import REPLICATES
from ..statistics.intervals import ratio_interval
from ..statistics.percentiles import PERCENTILES
from .change import Sample, change_of, probability_of_superiority

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from ..statistics.intervals import Interval

QUANTILES = {p.name: p.quantile for p in PERCENTILES}


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
    return _compare(_groups(base, options.match), _groups(new, options.match), base.schema, options)


class _Group:
    """The messages of one group in the order of time within each run; its samples are kept to be drawn from once."""

    def __init__(self, rows: pl.DataFrame) -> None:
        self._rows = rows
        self._samples: dict[str, Sample] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def sample(self, metric: str) -> Sample:
        """The values of a metric that are not null."""
        if metric not in self._samples:
            self._samples[metric] = Sample(self._rows[f"{metric}_ns"].drop_nulls().to_numpy())
        return self._samples[metric]

    def received(self, confidence: float) -> Interval:
        """Share of messages whose reply came back."""
        return ratio_interval((self._rows["outcome"] == "completed").to_numpy(), confidence)


_Groups = dict[tuple[Any, ...], _Group]


def _groups(frame: pl.DataFrame, match: Sequence[str]) -> _Groups:
    """The groups of a frame by the values of the match columns, sorted."""
    ordered = frame.sort(*match, "run_id", "relay_id", "publish_ns", nulls_last=False)
    return {
        tuple(part.row(0, named=True)[name] for name in match): _Group(part)
        for part in ordered.partition_by(*match, maintain_order=True)
    }


def _compare(
    before: _Groups, after: _Groups, schema: Mapping[str, pl.DataType], options: CompareOptions
) -> Comparison:
    rows: list[dict[str, Any]] = []
    delivery: list[dict[str, Any]] = []
    for key in (key for key in before if key in after):
        labels = dict(zip(options.match, key, strict=True))
        sides = {"base": before[key], "new": after[key]}
        delivery.append(
            labels | {k: v for side in sides for k, v in _delivery(side, sides[side], options).items()}
        )
        for metric in options.metrics:
            rows += (labels | row for row in _metric_rows(before[key], after[key], metric, options))
    label_schema = {name: schema[name] for name in options.match}
    return Comparison(
        rows=pl.DataFrame(rows, schema={**label_schema, **COMPARISON_SCHEMA}),
        delivery=pl.DataFrame(delivery, schema={**label_schema, **DELIVERY_SCHEMA}),
        only_base=_keys_frame([k for k in before if k not in after], label_schema),
        only_new=_keys_frame([k for k in after if k not in before], label_schema),
        options=options,
    )


def _delivery(side: str, group: _Group, options: CompareOptions) -> dict[str, Any]:
    ratio = group.received(options.confidence)
    return {
        f"{side}_published": len(group),
        f"{side}_received_ratio": ratio.value,
        f"{side}_received_ratio_low": ratio.lower,
        f"{side}_received_ratio_high": ratio.upper,
    }


def _metric_rows(base: _Group, new: _Group, metric: str, options: CompareOptions) -> Iterator[dict[str, Any]]:
    before, after = base.sample(metric), new.sample(metric)
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


def bridge_cost(roundtrips: pl.DataFrame, options: CompareOptions | None = None) -> pl.DataFrame:
    """What communication between different domains costs against the same domain, for equal parameters.

    Returns:
        One row per bridge, group, metric and statistic: `bridge` str, then the columns of `Comparison.rows` (base is
        the same domain without a bridge, new is the way through the bridge), `base_received_ratio` and
        `new_received_ratio` f64.
    """
    options = options or CompareOptions()
    match = tuple(name for name in options.match if name in BRIDGE_MATCH_COLUMNS)
    same = _groups(roundtrips.filter((pl.col("domain_mode") == "same") & (pl.col("bridge") == "none")), match)
    different = roundtrips.filter(pl.col("domain_mode") == "different")
    how = replace(options, match=match)
    ratios = ["base_received_ratio", "new_received_ratio"]
    tables = []
    for bridge in [
        *different["bridge"].unique().sort(),
        None,
    ]:  # without any bridge the columns are there all the same
        through = different.filter(pl.col("bridge").eq_missing(pl.lit(bridge, pl.String)))
        found = _compare(same, _groups(through, match), roundtrips.schema, how)
        rows = found.rows.join(
            found.delivery.select(*match, *ratios),
            on=list(match),
            how="left",
            nulls_equal=True,
            maintain_order="left",
        )
        tables.append(rows.select(pl.lit(bridge, pl.String).alias("bridge"), pl.all()))
    return pl.concat(tables)
