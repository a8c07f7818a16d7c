"""Two sets of round trips against each other: per group and statistic the change, its interval, a verdict.

Difference and ratio have an interval from the block bootstrap of both sides (`analyzer/statistics/bootstrap.py`); the effect is
the probability of superiority (R. McGraw and S. Wong, 1992; Cliff's delta, 1993, is twice that less one): how often a
message of the new side is faster than one of the base. One interval in twenty misses the truth by design: among many
groups a few verdicts are chance, which is why a gate (`analyzer/verdicts/gates.py`) takes a limit and not "worse".

Runs of one group are taken as one series. What differs from run to run but not within a run (a reboot, another
channel) is in no interval that a single run can give: repeat runs.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Protocol

import polars as pl

from ..model.parameters import MATCH_COLUMNS
from ..statistics.bootstrap import REPLICATES
from ..statistics.intervals import ratio_interval
from ..statistics.percentiles import PERCENTILES
from .change import Sample, change_of, probability_of_superiority
from .strata import replaced_devices, with_devices

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from ..model.parameters import ParameterValue
    from ..statistics.intervals import Interval

COMPARED_STATISTICS = ("mean", *(percentile.name for percentile in PERCENTILES))
"""Statistics of a metric that can be compared."""


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """How two sides are compared.

    Attributes:
        metrics: columns `<metric>_ns` to compare.
        statistics: those of `COMPARED_STATISTICS` to compare.
        match: columns that make two groups the same experiment.
        confidence: of every interval.
        same_within: a ratio wholly within `1 +- same_within` counts as the same.
        replicates: draws of the bootstrap.
    """

    metrics: tuple[str, ...] = ("latency", "rtt")
    statistics: tuple[str, ...] = COMPARED_STATISTICS
    match: tuple[str, ...] = MATCH_COLUMNS
    confidence: float = 0.95
    same_within: float = 0.05
    replicates: int = REPLICATES


@dataclass(frozen=True, slots=True)
class ChangeRow:
    """The columns of `Comparison.rows` behind the match columns: one statistic of one metric of one matched group.

    Times are in ns. `superiority` and `cliffs_delta` are of the metric, not of the statistic; delta is positive where
    new is faster. Null is what the samples do not support.
    """

    metric: str
    statistic: str
    base_messages: int
    new_messages: int
    base_ns: float | None
    new_ns: float | None
    new_low_ns: float | None
    new_high_ns: float | None
    difference_ns: float | None
    difference_low_ns: float | None
    difference_high_ns: float | None
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None
    superiority: float | None
    cliffs_delta: float | None
    verdict: str


@dataclass(frozen=True, slots=True)
class DeliveryRow:
    """The columns of `Comparison.delivery` behind the match columns: messages of one matched group on both sides."""

    base_published: int
    base_received_ratio: float | None
    base_received_ratio_low: float | None
    base_received_ratio_high: float | None
    new_published: int
    new_received_ratio: float | None
    new_received_ratio_low: float | None
    new_received_ratio_high: float | None


_DTYPES = {"str": pl.String, "int": pl.UInt64, "float | None": pl.Float64}
"""Annotation of a field of the rows above -> dtype of its column."""

COMPARISON_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(ChangeRow)}
DELIVERY_SCHEMA = {field.name: _DTYPES[str(field.type)] for field in fields(DeliveryRow)}


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The groups that two sides have in common, and those that only one side has.

    Attributes:
        rows: one row per matched group, metric and statistic: the match columns, then those of `ChangeRow`.
        delivery: one row per matched group: the match columns, then those of `DeliveryRow`.
        only_base: groups (match columns) that the new side does not have.
        only_new: groups that the base does not have.
        options: how the sides were compared.
        barred: groups (match columns) of either side in which a setting was not applied; no gate passes or fails on one.
    """

    rows: pl.DataFrame
    delivery: pl.DataFrame
    only_base: pl.DataFrame
    only_new: pl.DataFrame
    options: CompareOptions
    barred: pl.DataFrame = field(default_factory=pl.DataFrame)


class RoundTripSource(Protocol):
    """An analysis, as far as a comparison reads it."""

    def load_roundtrips(self) -> pl.DataFrame:
        """Read all round trips into memory."""

    @property
    def barred_groups(self) -> pl.DataFrame:
        """The parameter columns of the groups in which a setting was not applied."""


def compare(base: RoundTripSource, new: RoundTripSource, options: CompareOptions | None = None) -> Comparison:
    """Compare every group that two analyses measured; the round trips of both are in memory meanwhile.

    Args:
        base: an `Analysis`; `analyze(folder, details=False)` has all that is compared.
        new: the analysis of the other side.
        options: how to compare; None for the defaults.
    """
    comparison = compare_roundtrips(base.load_roundtrips(), new.load_roundtrips(), options)
    barred = [side.barred_groups.select(comparison.options.match) for side in (base, new)]
    return replace(comparison, barred=pl.concat(barred).unique(maintain_order=True))


def compare_roundtrips(
    base: pl.DataFrame,
    new: pl.DataFrame,
    options: CompareOptions | None = None,
) -> Comparison:
    """Compare the groups of two frames of round trips, as `compare` does.

    Args:
        base: rows of `docs/trace-format.md`.
        new: rows of the other side.
        options: how to compare; None for the defaults.
    """
    options = options or CompareOptions()
    new = with_devices(new, replaced_devices(base, new))
    return compare_groups(
        match_groups(base, options.match), match_groups(new, options.match), base.schema, options
    )


class MatchedGroup:
    """The messages of one group, with the samples that were drawn from: a sample is drawn from once.

    Args:
        rows: in the order of time within each run.
    """

    def __init__(self, rows: pl.DataFrame) -> None:
        self._rows = rows
        self._samples: dict[str, Sample] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def sample(self, metric: str) -> Sample:
        """Return the values of a metric that are not null."""
        if metric not in self._samples:
            self._samples[metric] = Sample(self._rows[f"{metric}_ns"].drop_nulls().to_numpy())
        return self._samples[metric]

    def received(self, confidence: float) -> Interval:
        """Return the share of messages whose reply came back."""
        return ratio_interval((self._rows["outcome"] == "completed").to_numpy(), confidence)


if TYPE_CHECKING:
    MatchedGroups = Mapping[tuple[ParameterValue, ...], MatchedGroup]
    """Values of the match columns -> group; sorted."""


def match_groups(roundtrips: pl.DataFrame, match: Sequence[str]) -> MatchedGroups:
    """Cut round trips into groups by the values of the match columns."""
    ordered = roundtrips.sort(*match, "run_id", "relay_id", "publish_ns", nulls_last=False)
    return {
        part.select(match).row(0): MatchedGroup(part)
        for part in ordered.partition_by(*match, maintain_order=True)
    }


def compare_groups(
    before: MatchedGroups,
    after: MatchedGroups,
    schema: Mapping[str, pl.DataType],
    options: CompareOptions,
) -> Comparison:
    """Compare groups of equal keys.

    Args:
        before: groups of the base, by the values of `options.match`.
        after: groups of the new side.
        schema: dtypes of the match columns, and of any others.
        options: how to compare.
    """
    rows: list[dict[str, ParameterValue]] = []
    delivery: list[dict[str, ParameterValue]] = []
    for key in (key for key in before if key in after):
        labels = dict(zip(options.match, key, strict=True))
        delivery.append(labels | asdict(_delivery(before[key], after[key], options.confidence)))
        rows += (labels | asdict(row) for row in _changes(before[key], after[key], options))
    labels_schema = {name: schema[name] for name in options.match}
    return Comparison(
        rows=pl.DataFrame(rows, schema={**labels_schema, **COMPARISON_SCHEMA}),
        delivery=pl.DataFrame(delivery, schema={**labels_schema, **DELIVERY_SCHEMA}),
        only_base=_keys_frame((key for key in before if key not in after), labels_schema),
        only_new=_keys_frame((key for key in after if key not in before), labels_schema),
        options=options,
    )


def _delivery(base: MatchedGroup, new: MatchedGroup, confidence: float) -> DeliveryRow:
    before, after = base.received(confidence), new.received(confidence)
    return DeliveryRow(
        base_published=len(base),
        base_received_ratio=before.value,
        base_received_ratio_low=before.lower,
        base_received_ratio_high=before.upper,
        new_published=len(new),
        new_received_ratio=after.value,
        new_received_ratio_low=after.lower,
        new_received_ratio_high=after.upper,
    )


def _changes(base: MatchedGroup, new: MatchedGroup, options: CompareOptions) -> Iterator[ChangeRow]:
    for metric in options.metrics:
        before, after = base.sample(metric), new.sample(metric)
        superiority = probability_of_superiority(before, after)
        for statistic in options.statistics:
            change = change_of(before, after, statistic, options.confidence, options.replicates)
            yield ChangeRow(
                metric=metric,
                statistic=statistic,
                base_messages=len(before),
                new_messages=len(after),
                base_ns=change.base,
                new_ns=change.new,
                new_low_ns=change.new_low,
                new_high_ns=change.new_high,
                difference_ns=change.difference,
                difference_low_ns=change.difference_low,
                difference_high_ns=change.difference_high,
                ratio=change.ratio,
                ratio_low=change.ratio_low,
                ratio_high=change.ratio_high,
                superiority=superiority,
                cliffs_delta=None if superiority is None else 2 * superiority - 1,
                verdict=change.verdict(options.same_within).value,
            )


def _keys_frame(
    keys: Iterable[tuple[ParameterValue, ...]], schema: Mapping[str, pl.DataType]
) -> pl.DataFrame:
    return pl.DataFrame(list(keys), schema=schema, orient="row")
