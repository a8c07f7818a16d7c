"""Two sets of round trips against each other: for each group and statistic the change, its interval, and an adjusted verdict."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import polars as pl

from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Run, Session

from ..model.finding import Finding
from ..model.metrics import TOPIC_METRICS
from ..model.parameters import MATCH_COLUMNS, ParameterValue
from ..model.presenter import presenter
from ..model.runs import pass_numbers, passes_of, topics_in_blocks
from ..run_statistics.between_runs import Estimate
from ..run_statistics.change import (
    Change,
    DetectableChange,
    LeastVariances,
    Passes,
    change_of_estimates,
    detectable_changes,
    least_variances,
    probability_of_superiority,
)
from ..run_statistics.received import DeliveryChange, change_of_received
from ..run_statistics.runs import MEAN, Statistic
from ..statistics.percentiles import PERCENTILES
from .comparison_rows import (
    COMPARISON_SCHEMA,
    DELIVERY_SCHEMA,
    DISTRIBUTION_SCHEMA,
    ChangeRow,
    DeliveryRow,
    DistributionRow,
    at_levels,
    with_clock_bounds,
)
from .ignoring import check_match, ignored_sentences
from .judgements import adjusted_p_values, with_adjusted_verdicts
from .matching import (
    MatchedGroup,
    completed_key,
    interleaved_keys,
    match_groups,
    pair_keys,
    partner_differences,
    partner_groups,
    replaced_devices,
    unmatched,
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
)

if TYPE_CHECKING:
    from .matching import Key


Label = dict[str, ParameterValue]


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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Comparison:
    """The groups that two sides have in common, and those that only one side has.

    `rows` has the match columns and `ChangeRow` of each matched group, metric and statistic, `delivery` likewise `DeliveryRow`
    of each group. Groups that are `busier` and repeats `left_out` are not judged, as the machine of one side was busier.
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

    def __repr__(self) -> str:
        """Return the number of results of both sides and of only one."""
        results = f"{counted(len(self.delivery), 'result')} of both sides"
        return f"<Comparison: {results}, {len(self.only_base)} only in the base, {len(self.only_new)} only in the new side>"

    def _repr_html_(self) -> str:
        return presenter().comparison_screen(self)

    def sights(self) -> tuple[DetectableChange, ...]:
        """Return the smallest change that the verdicts would have detected, for each metric and statistic."""
        match = self.options.match
        results = {key: number for number, key in enumerate(self.delivery.select(match).rows())}
        names = self.rows.select("metric", "statistic").rows()
        keys = self.rows.select(match).rows()
        changes = ((*name, results[key], change) for name, key, change in zip(names, keys, self.changes, strict=True))
        return detectable_changes(changes, self.options.confidence, self.options.same_within)


class ComparedSide(Protocol):
    """An analysis, as far as a comparison reads it."""

    @property
    def sessions(self) -> Sequence[Session]:
        """The recording processes."""

    @property
    def runs(self) -> Sequence[Run]:
        """The descriptions of the runs."""

    @property
    def findings(self) -> Sequence[Finding]:
        """What is doubtful."""

    @property
    def details(self) -> Any:
        """Has the samples of the host."""

    @property
    def summary(self) -> pl.DataFrame:
        """One row per group."""

    @property
    def topic_messages(self) -> pl.DataFrame:
        """The messages of the topics that taps heard."""

    @property
    def barred_groups(self) -> pl.DataFrame:
        """The parameter columns of the groups in which a setting was not applied."""

    def load_messages(self) -> pl.DataFrame:
        """Read the round trips, with a row for each message that never left."""


def compare(base: ComparedSide, new: ComparedSide, options: CompareOptions | None = None) -> Comparison:
    """Compare every group that two analyses measured (`details=False` is enough); interleaved sides repeat by repeat.

    Raises:
        OptionError: without the columns that are not matched, two groups of one side would be one.
    """
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


def _groups_of(side: ComparedSide) -> pl.DataFrame:
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
    before: Mapping[Key, MatchedGroup],
    after: Mapping[Key, MatchedGroup],
    schema: Mapping[str, pl.DataType],
    options: CompareOptions,
    passes: Mapping[int, int] | None = None,
) -> Comparison:
    """Compare groups of equal keys (`matching.pair_keys`); `schema` has the dtypes of the match columns."""
    pairs = pair_keys(before, after, options.match)
    row_keys: dict[Key, Key] = {}
    labels: list[Label] = []
    deliveries: list[DeliveryChange] = []
    rows: list[tuple[Label, ChangeRow, Change]] = []
    distributions: list[Label] = []
    least = _least_variances([(before[key], after[partner]) for key, partner in pairs.items()], options, passes or {})
    for key, partner in pairs.items():
        base, new = before[key], after[partner]
        row_keys[key] = row_keys[partner] = completed_key(key, partner, options.match)
        label: Label = dict(zip(options.match, row_keys[key], strict=True))
        labels.append(label)
        deliveries.append(change_of_received(base.received, new.received, options.confidence))
        for distribution, changes in _changes(base, new, deliveries[-1], options, passes or {}, least):
            distributions.append(label | vars(distribution))
            rows += ((label, *changed) for changed in changes)
    match_schema = {name: schema[name] for name in options.match}
    change_rows = [label | vars(row) for label, row, _ in rows]
    losses = adjusted_p_values([change.p_value for change in deliveries])
    delivery_rows = [
        label | vars(_delivery_row(before[key], after[partner], change, p_adjusted))
        for label, (key, partner), change, p_adjusted in zip(labels, pairs.items(), deliveries, losses, strict=True)
    ]
    return Comparison(
        rows=with_adjusted_verdicts(
            pl.DataFrame(change_rows, {**match_schema, **COMPARISON_SCHEMA}), options.confidence
        ),
        delivery=pl.DataFrame(delivery_rows, {**match_schema, **DELIVERY_SCHEMA}),
        distributions=pl.DataFrame(distributions, {**match_schema, **DISTRIBUTION_SCHEMA}),
        only_base=pl.DataFrame(list(unmatched(before, pairs)), match_schema, orient="row"),
        only_new=pl.DataFrame(list(unmatched(after, pairs.values())), match_schema, orient="row"),
        options=options,
        changes=tuple(change for _, __, change in rows),
        deliveries=tuple(deliveries),
        unfinished={
            row_keys[key]: before[key].unfinished + after[partner].unfinished for key, partner in pairs.items()
        },
        row_keys=row_keys,
    )


def _delivery_row(
    base: MatchedGroup, new: MatchedGroup, change: DeliveryChange, p_adjusted: float | None
) -> DeliveryRow:
    sides = {"base": (base, change.base), "new": (new, change.new)}
    of_sides: dict[str, Any] = {
        f"{name}_{field}": value
        for name, (side, received) in sides.items()
        for field, value in (
            ("published", len(side)),
            ("received_ratio", received.value),
            ("received_ratio_low", received.lower),
            ("received_ratio_high", received.upper),
            ("runs", received.runs),
        )
    }
    return DeliveryRow(
        **of_sides,
        **_equal_fields(change, ("difference", "difference_low", "difference_high", "smallest_drop", "p_value")),
        verdict=change.verdict(p_adjusted=p_adjusted).value,
        basis=change.basis.value,
        is_dead=new.is_dead and not base.is_dead,
        environment=UNKNOWN,
        p_adjusted=p_adjusted,
    )


def _equal_fields(record: object, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(record, name) for name in names}


def _metrics(base: MatchedGroup, options: CompareOptions) -> list[str]:
    return [metric for metric in options.metrics if (metric in TOPIC_METRICS) == base.is_topic]


def _least_variances(
    groups: Sequence[tuple[MatchedGroup, MatchedGroup]], options: CompareOptions, passes: Mapping[int, int]
) -> dict[tuple[str, str], LeastVariances]:
    statistics = [STATISTIC_BY_NAME[name] for name in options.statistics]
    sides: dict[tuple[str, str], list[tuple[Estimate, Estimate, Passes | None]]] = {}
    for base, new in groups:
        paired = passes_of(base.runs, new.runs, passes) if options.paired else None
        for metric in _metrics(base, options):
            estimates = (side.estimates(metric, statistics, options.confidence) for side in (base, new))
            for name, base_estimate, other in zip(options.statistics, *estimates, strict=True):
                sides.setdefault((metric, name), []).append((base_estimate, other, paired))
    return {key: least_variances(own) for key, own in sides.items()}


def _changes(
    base: MatchedGroup,
    new: MatchedGroup,
    received: DeliveryChange,
    options: CompareOptions,
    passes: Mapping[int, int],
    least: Mapping[tuple[str, str], LeastVariances],
) -> Iterator[tuple[DistributionRow, list[tuple[ChangeRow, Change]]]]:
    paired = passes_of(base.runs, new.runs, passes) if options.paired else None
    p_of_losses = 1.0 if received.p_value is None else received.p_value
    for metric in _metrics(base, options):
        before, after = base.delivered(metric), new.delivered(metric)
        superiority = probability_of_superiority(before.ordered, after.ordered)
        statistics = [STATISTIC_BY_NAME[name] for name in options.statistics]
        estimates = (side.estimates(metric, statistics, options.confidence) for side in (base, new))
        changes = []
        for name, statistic, base_estimate, other in zip(options.statistics, statistics, *estimates, strict=True):
            change = change_of_estimates(base_estimate, other, paired, p_of_losses, least[metric, name])
            sides = {"base": (base, change.base, received.base), "new": (new, change.new, received.new)}
            of_sides: dict[str, Any] = {
                f"{side}_{field}": value
                for side, (group, interval, share) in sides.items()
                for field, value in (
                    ("messages", len(group.survivors(metric))),
                    ("ns", interval.value),
                    ("low_ns", interval.lower),
                    ("high_ns", interval.upper),
                    ("received_ratio", share.value),
                    ("survivors_ns", group.of_survivors(metric, statistic)),
                    ("runs", interval.runs),
                    ("episodes", interval.episodes),
                )
            }
            differences = {
                f"{field}_ns": getattr(change, field) for field in ("difference", "difference_low", "difference_high")
            }
            row = ChangeRow(
                metric=metric,
                statistic=name,
                **of_sides,
                **differences,
                **_equal_fields(change, ("ratio", "ratio_low", "ratio_high", "pairs", "p_value", "smallest_ratio")),
                superiority=superiority,
                cliffs_delta=None if superiority is None else 2 * superiority - 1,
                verdict=change.verdict(options.same_within).value,
                basis=change.basis.value,
                p_adjusted=None,
                base_typical_ns=change.typical[0],
                new_typical_ns=change.typical[1],
            )
            changes.append((with_clock_bounds(row, base.bound_ns, new.bound_ns), change))
        yield DistributionRow(metric, at_levels(before.ordered), at_levels(after.ordered)), changes
