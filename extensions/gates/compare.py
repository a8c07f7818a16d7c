"""Two sets of round trips against each other: for each group and statistic the change, its interval, and an adjusted verdict."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.detail_frames import COMPARISON_SCHEMA
from dds_trace.analyzer.model.metrics import TOPIC_METRICS
from dds_trace.analyzer.model.names import group_words, varying_parameters
from dds_trace.analyzer.model.parameters import MATCH_COLUMNS, ParameterValue
from dds_trace.analyzer.model.runs import pass_numbers
from dds_trace.analyzer.run_statistics.between_runs import Estimate
from dds_trace.analyzer.run_statistics.change import (
    Change,
    LeastVariances,
    Passes,
    change_of_estimates,
    least_variances,
)
from dds_trace.analyzer.run_statistics.received import DeliveryChange, change_of_received
from dds_trace.analyzer.run_statistics.runs import MEAN, Statistic
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.analyzer.verdicts.judgements import Claim, Judgement, judged_change, judgement_frame
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.base.extension import load
from dds_trace.base.units import counted

from . import comparison_rows
from .detectable import DetectableChange, detectable_changes, probability_of_superiority
from .ignoring import check_match, ignored_sentences
from .matching import (
    Key,
    completed_key,
    interleaved_keys,
    match_groups,
    pair_keys,
    partner_differences,
    partner_groups,
    passes_of,
    replaced_devices,
    topics_in_blocks,
    with_devices,
    with_partners,
)
from .sides import (
    UNKNOWN,
    BusierRepeat,
    RunLoad,
    SideError,
    busier_repeats,
    busier_side,
    difference_sentences,
    environment_differences,
    environment_of_group,
    errors_of,
    recorded_apart,
    run_loads,
    side_names,
)

Label = dict[str, ParameterValue]


RECEIVED_RATIO = "received_ratio"
BASE = "the base"
_SHARE_COLUMNS = {"value": "difference", "low": "difference_low", "high": "difference_high", "p": "p_value"}
_SHARE_COLUMNS |= {name: name for name in ("basis", "p_adjusted", "verdict")}

STATISTIC_BY_NAME = {"mean": MEAN, **{p.name: Statistic(p.quantile) for p in PERCENTILES}}

COMPARED_STATISTICS = tuple(STATISTIC_BY_NAME)

FAMILY = "Benjamini-Hochberg over groups and statistics"


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """How two sides are compared.

    Attributes:
        metrics: columns `<metric>_ns` to compare.
        statistics: some of `COMPARED_STATISTICS`.
        match: columns that make two groups the same experiment; fewer than `MATCH_COLUMNS` pair groups that differ in the
            others, refused where that merges two groups of a side.
        confidence: of every interval.
        same_within: a ratio wholly within `1 +- same_within` counts as the same.
        paired: whether to compare repeat by repeat (label `pass` of a run).
    """

    metrics: tuple[str, ...] = ("latency", "rtt")
    statistics: tuple[str, ...] = COMPARED_STATISTICS
    match: tuple[str, ...] = MATCH_COLUMNS
    confidence: float = 0.95
    same_within: float = 0.05
    paired: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The groups that two sides have in common, and those that only one side has.

    `rows` has the match columns and `COMPARISON_SCHEMA` of each matched group, metric and statistic, `delivery` likewise
    `DELIVERY_SCHEMA` of each group. Groups that are `busier` and repeats `left_out` are not judged, as the machine of one side was busier.
    """

    rows: pl.DataFrame
    delivery: pl.DataFrame
    distributions: pl.DataFrame
    only_base: pl.DataFrame
    only_new: pl.DataFrame
    options: CompareOptions
    changes: tuple[Change, ...] = ()
    deliveries: tuple[DeliveryChange, ...] = ()
    environment: tuple[str, ...] = ()
    names: tuple[str, str] | None = None
    errors: tuple[SideError, ...] = ()
    barred: frozenset[Key] = frozenset()
    interleaved: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    order: str = ""
    unfinished: Mapping[Key, int] = field(default_factory=dict)
    same_recordings: bool = False
    row_keys: Mapping[Key, Key] = field(default_factory=dict)
    busier: frozenset[Key] = frozenset()
    left_out: tuple[BusierRepeat, ...] = ()
    measured: Mapping[Key, tuple[SetupRuns, SetupRuns]] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return the number of results of both sides and of only one."""
        results = f"{counted(len(self.delivery), 'result')} of both sides"
        return f"<Comparison: {results}, {len(self.only_base)} only in the base, {len(self.only_new)} only in the new side>"

    def _repr_html_(self) -> str:
        screen: str = load("parts", "presenter").comparison_screen(self)
        return screen

    @cached_property
    def judgements(self) -> tuple[Judgement, ...]:
        """Of each result as a whole (without a statistic), of its share received, and of each time."""
        match = self.options.match
        names = varying_parameters(self.delivery, match)
        changes = self.rows.rows_by_key(match, named=True)
        rows: list[Judgement] = []
        for number, (key, received) in enumerate(
            zip(self.delivery.select(match).rows(), self.delivery.iter_rows(named=True), strict=True)
        ):
            whole = comparison_rows.verdict_of_result(received, changes[key], is_busier=key in self.busier)
            about = Claim.CHANGED, group_words(received, names)
            numbers = {name: received[column] for name, column in _SHARE_COLUMNS.items()}
            rows += [
                Judgement(*about, "", BASE, verdict=whole, group=number),
                Judgement(*about, RECEIVED_RATIO, BASE, **numbers, group=number),
                *(judged_change(*about, row, BASE, number) for row in changes[key]),
            ]
        return tuple(rows)

    def frame(self, gates: Iterable[Judgement] = ()) -> pl.DataFrame:
        """Return the judgements, and the outcomes of gates, with the columns of `Analysis.judgements`."""
        return judgement_frame([*self.judgements, *gates])

    def changes_of(self, metric: str, statistic: str = "") -> Iterator[tuple[dict[str, Any], Change]]:
        """Yield the rows of a metric or of `received_ratio` with their changes."""
        if metric == RECEIVED_RATIO:
            yield from zip(self.delivery.iter_rows(named=True), self.deliveries, strict=True)
            return
        for row, change in zip(self.rows.iter_rows(named=True), self.changes, strict=True):
            if row["metric"] == metric and statistic in ("", row["statistic"]):
                yield row, change

    def sights(self) -> tuple[DetectableChange, ...]:
        """Return the smallest change that the verdicts would have detected."""
        match = self.options.match
        results = {key: number for number, key in enumerate(self.delivery.select(match).rows())}
        rows = self.rows.select("metric", "statistic", *match).rows()
        changes = ((*row[:2], results[row[2:]], change) for row, change in zip(rows, self.changes, strict=True))
        return detectable_changes(changes, self.options.confidence, self.options.same_within)


def compare(base: Analysis, new: Analysis, options: CompareOptions | None = None) -> Comparison:
    """Compare every group that two analyses measured (`details=False` is enough); interleaved sides repeat by repeat.

    Of two bags it returns a report.

    Raises:
        OptionError: without the columns that are not matched, two groups of one side would be one.
    """
    if not all(hasattr(side, "topic_messages") for side in (base, new)):
        drives: Comparison = load("parts", "side_by_side")(base, new)
        return drives
    options = options or CompareOptions()
    if not all(side.topic_messages.is_empty() for side in (base, new)):
        first = TOPIC_METRICS if all(side.summary.is_empty() for side in (base, new)) else ()
        options = replace(options, metrics=tuple(dict.fromkeys([*first, *options.metrics, *TOPIC_METRICS])))
    match = options.match
    base_groups, new_groups = _groups_of(base), _groups_of(new)
    check_match(base_groups, "base", match)
    check_match(new_groups, "new side", match)
    before, after = base.load_messages(), new.load_messages()
    if base is new:
        before = after = topics_in_blocks(before)
    loads = run_loads(() if base is new else (base, new))
    left_out = tuple(busier_repeats(base.runs, new.runs, loads))
    is_judged = ~pl.col("run_id").is_in([run_id for repeat in left_out for run_id in repeat.runs])
    before, after = (side.filter(is_judged) if left_out else side for side in (before, after))
    run_partners = interleaved_keys(before, after, base.runs, new.runs, match)
    partners = partner_groups(after, run_partners, match)
    names = replaced_devices(base_groups, new_groups)
    comparison = compare_roundtrips(
        before,
        with_partners(after, run_partners, match) if run_partners else after,
        replace(options, paired=options.paired or bool(run_partners)),
        passes=pass_numbers([*base.runs, *new.runs]),
        unfinished=frozenset(run.run_id for run in (*base.runs, *new.runs) if run.state != "finished"),
    )

    def keys_of(side: pl.DataFrame, side_names: Mapping[str, str]) -> list[Key]:
        renamed = with_devices(side, side_names).select(match).rows()
        keys = [partners.get(group_key, key) for group_key, key in zip(side.select(match).rows(), renamed, strict=True)]
        return [comparison.row_keys.get(key, key) for key in keys]

    def loads_of(messages: pl.DataFrame, side_names: Mapping[str, str]) -> dict[Key, list[RunLoad]]:
        runs = messages.select(*match, "run_id").unique().filter(pl.col("run_id").is_in(list(loads)))
        pairs = list(zip(keys_of(runs, side_names), runs["run_id"], strict=True))
        return {key: [loads[run_id] for other, run_id in pairs if other == key] for key, _ in pairs}

    order = recorded_apart(base.sessions, new.sessions)
    base_loads, new_loads = (loads_of(before, {}), loads_of(after, names)) if order else ({}, {})
    busier = {key: text for key in base_loads if (text := busier_side(base_loads[key], new_loads.get(key, ())))}
    verdicts = [
        "inconclusive" if tuple(key) in busier else verdict
        for *key, verdict in comparison.rows.select(*match, "verdict").iter_rows()
    ]
    differences = environment_differences(base.sessions, new.sessions, names)
    environments = [environment_of_group(row, differences) for row in comparison.delivery.iter_rows(named=True)]
    return replace(
        comparison,
        delivery=comparison.delivery.with_columns(pl.Series("environment", environments, pl.String)),
        barred=frozenset([*keys_of(base.barred_groups, {}), *keys_of(new.barred_groups, names)]),
        environment=difference_sentences(differences),
        names=side_names(differences),
        interleaved=partner_differences(partners, match),
        ignored=ignored_sentences(base_groups, new_groups, match),
        same_recordings=before.equals(after),
        rows=comparison.rows.with_columns(pl.Series("verdict", verdicts, pl.String)),
        order=order,
        busier=frozenset(busier),
        left_out=left_out,
        errors=(
            *(SideError(f"{text}: record again", frozenset({key})) for key, text in busier.items()),
            *errors_of("base", base.findings, keys_of(base.summary, {})),
            *(() if before.equals(after) else errors_of("new", new.findings, keys_of(new.summary, names))),
        ),
    )


def _groups_of(side: Analysis) -> pl.DataFrame:
    topics = side.topic_messages.select(MATCH_COLUMNS).unique(maintain_order=True)
    return pl.concat([side.summary.select(MATCH_COLUMNS), topics]) if len(topics) else side.summary


def compare_roundtrips(
    base: pl.DataFrame,
    new: pl.DataFrame,
    options: CompareOptions | None = None,
    passes: Mapping[int, int] | None = None,
    unfinished: Collection[int] = (),
) -> Comparison:
    """Compare the groups of two frames of round trips.

    `passes` is run_id -> repeat; `unfinished` are the ids of runs without an end.
    """
    options = options or CompareOptions()
    new = with_devices(new, replaced_devices(base, new))
    before, after = (match_groups(side, options.match, unfinished) for side in (base, new))
    return compare_groups(before, after, base.schema, options, passes)


def compare_groups(
    before: Mapping[Key, SetupRuns],
    after: Mapping[Key, SetupRuns],
    schema: Mapping[str, pl.DataType],
    options: CompareOptions,
    passes: Mapping[int, int] | None = None,
) -> Comparison:
    """Compare groups of equal keys (`matching.pair_keys`); `schema` has the dtypes of the match columns."""
    pairs = pair_keys(before, after, options.match)
    row_keys: dict[Key, Key] = {}
    deliveries: list[DeliveryChange] = []
    changes: list[Change] = []
    delivery, rows, distributions = (list[dict[str, Any]]() for _ in range(3))
    least = _least_variances([(before[key], after[partner]) for key, partner in pairs.items()], options, passes or {})
    for key, partner in pairs.items():
        base, new = before[key], after[partner]
        row_keys[key] = row_keys[partner] = completed_key(key, partner, options.match)
        label = dict(zip(options.match, row_keys[key], strict=True))
        deliveries.append(change_of_received(base.received, new.received, options.confidence))
        delivery.append(label | _delivery_row(base, new, deliveries[-1]))
        paired = passes_of(base.runs, new.runs, passes or {}) if options.paired else None
        for metric in _metrics(base, options):
            before_ns, after_ns = (side.delivered(metric).ordered for side in (base, new))
            times = {"base_ns": comparison_rows.at_levels(before_ns), "new_ns": comparison_rows.at_levels(after_ns)}
            distributions.append(label | {"metric": metric} | times)
            superiority = probability_of_superiority(before_ns, after_ns)
            for name, estimate, other in _estimates(base, new, metric, options):
                p_of_losses = 1.0 if deliveries[-1].p_value is None else deliveries[-1].p_value
                changes.append(change_of_estimates(estimate, other, paired, p_of_losses, least[metric, name]))
                row = _change_row(base, new, deliveries[-1], changes[-1], metric, name) | {
                    "superiority": superiority,
                    "cliffs_delta": None if superiority is None else 2 * superiority - 1,
                    "verdict": changes[-1].verdict(options.same_within).value,
                }
                rows.append(label | comparison_rows.with_clock_bounds(row, base.bound_ns, new.bound_ns))
    match_schema, matched = {name: schema[name] for name in options.match}, {*pairs.values()}
    delivery_frame, row_frame = (
        comparison_rows.with_adjusted_verdicts(pl.DataFrame(own, {**match_schema, **columns}), options.confidence)
        for own, columns in ((delivery, comparison_rows.DELIVERY_SCHEMA), (rows, COMPARISON_SCHEMA))
    )
    return Comparison(
        rows=row_frame,
        delivery=delivery_frame,
        distributions=pl.DataFrame(distributions, {**match_schema, **comparison_rows.DISTRIBUTION_SCHEMA}),
        only_base=pl.DataFrame([key for key in before if key not in pairs], match_schema, orient="row"),
        only_new=pl.DataFrame([key for key in after if key not in matched], match_schema, orient="row"),
        options=options,
        changes=tuple(changes),
        deliveries=tuple(deliveries),
        unfinished={
            row_keys[key]: before[key].unfinished + after[partner].unfinished for key, partner in pairs.items()
        },
        row_keys=row_keys,
        measured={row_keys[key]: (before[key], after[partner]) for key, partner in pairs.items()},
    )


def _delivery_row(base: SetupRuns, new: SetupRuns, change: DeliveryChange) -> dict[str, Any]:
    row = {name: getattr(change, name) for name in _DELIVERY_COLUMNS}
    for name, side, received in (("base", base, change.base), ("new", new, change.new)):
        ratio = f"{name}_received_ratio"
        row |= {ratio: received.value, f"{ratio}_low": received.lower, f"{ratio}_high": received.upper}
        row |= {f"{name}_published": side.published, f"{name}_runs": received.runs}
    return row | {
        "verdict": change.verdict().value,
        "basis": change.basis.value,
        "is_dead": new.is_dead and not base.is_dead,
        "environment": UNKNOWN,
    }


_DELIVERY_COLUMNS = ("difference", "difference_low", "difference_high", "smallest_drop", "p_value")
_CHANGE_COLUMNS = ("ratio", "ratio_low", "ratio_high", "pairs", "p_value", "smallest_ratio")
"""Columns that a change has by the same name."""


def _change_row(
    base: SetupRuns, new: SetupRuns, received: DeliveryChange, change: Change, metric: str, name: str
) -> dict[str, Any]:
    row: dict[str, Any] = {"metric": metric, "statistic": name, "basis": change.basis.value}
    row |= {column: getattr(change, column) for column in _CHANGE_COLUMNS}
    row |= {f"{column}_ns": getattr(change, column) for column in ("difference", "difference_low", "difference_high")}
    sides = (("base", base, change.base, received.base), ("new", new, change.new, received.new))
    for (side, group, interval, share), typical_ns in zip(sides, change.typical, strict=True):
        row |= {f"{side}_ns": interval.value, f"{side}_low_ns": interval.lower, f"{side}_high_ns": interval.upper}
        row |= {f"{side}_typical_ns": typical_ns, f"{side}_received_ratio": share.value}
        row |= {f"{side}_runs": interval.runs, f"{side}_episodes": interval.episodes}
        row |= {
            f"{side}_messages": len(group.survivors(metric)),
            f"{side}_survivors_ns": group.of_survivors(metric, STATISTIC_BY_NAME[name]),
        }
    return row


def _metrics(base: SetupRuns, options: CompareOptions) -> list[str]:
    return [metric for metric in options.metrics if (metric in TOPIC_METRICS) == base.is_topic]


def _estimates(
    base: SetupRuns, new: SetupRuns, metric: str, options: CompareOptions
) -> Iterator[tuple[str, Estimate, Estimate]]:
    statistics = [STATISTIC_BY_NAME[name] for name in options.statistics]
    before, after = (side.estimates_of(metric, statistics, options.confidence) for side in (base, new))
    return zip(options.statistics, before, after, strict=True)


def _least_variances(
    groups: Sequence[tuple[SetupRuns, SetupRuns]], options: CompareOptions, passes: Mapping[int, int]
) -> dict[tuple[str, str], LeastVariances]:
    sides: dict[tuple[str, str], list[tuple[Estimate, Estimate, Passes | None]]] = {}
    for base, new in groups:
        paired = passes_of(base.runs, new.runs, passes) if options.paired else None
        for metric in _metrics(base, options):
            for name, estimate, other in _estimates(base, new, metric, options):
                sides.setdefault((metric, name), []).append((estimate, other, paired))
    return {key: least_variances(own) for key, own in sides.items()}
