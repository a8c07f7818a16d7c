"""A comparison in words: the answer, its results worst first, and what it rests on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import polars as pl

from dds_trace.analyzer.model.names import group_words
from dds_trace.analyzer.model.parameters import MATCH_COLUMNS, SERIES_COLUMNS
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.statistics.power import POWER
from dds_trace.analyzer.verdicts.judgements import Judgement
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import counted, format_ratio, joined
from dds_trace.reports.book.groups import VENDORS, Cell, VendorLabels, group_labels, groups_of
from dds_trace.reports.book.verdicts import received_words

from .compare import FAMILY, Comparison
from .comparison_rows import WORST_FIRST, shown_changes
from .detectable import DetectableChange, among_tests
from .gate import METRIC_AND_STATISTIC, Against, GateOutcome
from .gates import FAMILY as GATE_FAMILY
from .gates import GateResult, overall_outcome
from .ignoring import columns_to_ignore, unlike_columns
from .sides import SAME, UNKNOWN
from .words import (
    MOST_RATIO,
    Gated,
    change_words,
    metric_words,
    statistic_words,
    unjudged_words,
    with_article,
    with_undecided,
)

UNCHANGED = {"no clear change", "undecided", "too few runs", "the same"}


@dataclass(frozen=True, slots=True)
class ComparedGroup:
    """A result of both sides: `judged` are its rows of the frame, of the share received and of each time."""

    label: str
    verdict: str
    judged: tuple[Judgement, ...]
    delivery: Mapping[str, Any]
    changes: tuple[Mapping[str, Any], ...]
    distributions: tuple[Mapping[str, Any], ...]
    unlike: str

    @property
    def message(self) -> str:
        return Cell(**{name: self.delivery[name] for name in Cell.__dataclass_fields__}).label

    @property
    def setup(self) -> str:
        return self.label.removeprefix(self.message).removeprefix(", ")

    def shown(self) -> tuple[Mapping[str, Any], ...]:
        return shown_changes(self.changes)

    def times(self, *, shown: bool = False) -> list[Judgement]:
        names = {f"{row['metric']}_{row['statistic']}" for row in self.shown()}
        return [row for row in self.judged[1:] if not shown or row.statistic in names]

    @property
    def where(self) -> str:
        verdict = {"slower": "worse", "faster": "better"}.get(self.verdict, "")
        metrics = {row.statistic: METRIC_AND_STATISTIC[row.statistic] for row in self.times()}
        first = self.changes[0]["metric"]
        tested = [row for row in self.times() if row.p is not None and metrics[row.statistic][0] == first]
        agreeing = [row for row in tested if row.verdict == verdict]
        if agreeing:
            all_agree = len(agreeing) == len(tested)
            return "" if all_agree else ", ".join(statistic_words(metrics[row.statistic][1]) for row in agreeing)
        judged = [metric_words(metrics[row.statistic][0]).lower() for row in self.times() if row.verdict == verdict]
        return ", ".join(dict.fromkeys(judged))


@dataclass(frozen=True, slots=True)
class Unlike:
    column: str
    base: str
    new: str


@dataclass(frozen=True, slots=True)
class ComparisonInfo:
    """Contents of the reports of a comparison.

    Attributes:
        answer: the answer, for people.
        seen: which changes would not have been seen, or how sides without a common result differ; for people.
        groups: the results of both sides, worst first.
        only_base: results that the new side does not have.
        only_new: results that the base does not have.
        outcome: of the gates; null without one.
        gates: outcome of each gate and result, in the unit of its limit; the worst first.
        sights: which changes the verdicts would have seen.
        unlike: columns in which sides without a common result differ.
        ignore: columns for --ignore, without which such sides can be compared.
        notes: what makes the sides unlike or unfit.
        rules: how to read the numbers.
    """

    answer: tuple[str, ...]
    seen: str
    groups: tuple[ComparedGroup, ...]
    metric: str
    only_base: tuple[str, ...]
    only_new: tuple[str, ...]
    outcome: GateOutcome | None
    gates: tuple[Gated, ...]
    sights: tuple[DetectableChange, ...]
    unlike: tuple[Unlike, ...]
    ignore: tuple[str, ...]
    notes: tuple[str, ...]
    rules: tuple[str, ...]

    @property
    def said(self) -> str:
        return " ".join(self.answer)

    @property
    def is_changed(self) -> bool:
        verdicts = {group.verdict for group in self.groups} - UNCHANGED
        return bool(verdicts or self.only_base or self.only_new) or self.outcome is GateOutcome.REGRESSED


def comparison_info(comparison: Comparison, results: Sequence[GateResult] = ()) -> ComparisonInfo:
    frames = (comparison.delivery, comparison.only_base, comparison.only_new)
    labels = _labels(frames)
    ends = [sum(map(len, frames[:count])) for count in range(4)]
    shared, only_base, only_new = (tuple(labels[start:end]) for start, end in pairwise(ends))
    groups = _groups(comparison, shared)
    sights = comparison.sights()
    apart = (comparison.only_base, comparison.only_new)
    outcome = overall_outcome(result.outcome for result in results) if results else None
    unlike = () if groups else tuple(Unlike(name, *values) for name, values in unlike_columns(*apart).items())
    ignore = () if groups else columns_to_ignore(*apart)
    if ignore:  # with those that are ignored already
        ignore = tuple(name for name in MATCH_COLUMNS if name in ignore or name not in comparison.options.match)
    gates = _gates(comparison, results, shared, only_base)
    answer: tuple[str, ...] = ("The two sides have no result in common: there is nothing to compare.",)
    if comparison.same_recordings:
        answer = ("Both sides are the same recordings: nothing can have changed.",)
    elif groups:
        is_whole = not only_base and outcome in (None, GateOutcome.PASSED)
        answer = _answer(groups, is_whole=is_whole, fails=outcome is GateOutcome.REGRESSED)
    first, *others = with_undecided(answer, gates)
    return ComparisonInfo(
        answer=(first, *_decided_words(comparison, gates), *others),
        seen=("" if comparison.same_recordings else _seen(sights, groups, shared))
        if groups
        else _unlike_words(unlike, ignore),
        groups=groups,
        metric=metric_words(comparison.options.metrics[0]),
        only_base=only_base,
        only_new=only_new,
        outcome=outcome,
        gates=gates,
        sights=sights,
        unlike=unlike,
        ignore=ignore,
        notes=comparison_notes(comparison),
        rules=_rules(comparison, gated=bool(results)),
    )


def _decided_words(comparison: Comparison, gates: Sequence[Gated]) -> list[str]:
    """Of the statistics of undecided gates, and of the median."""
    undecided = [gated.result.gate for gated in gates if gated.result.outcome is GateOutcome.INCONCLUSIVE]
    judged = [(gate.metric, gate.statistic) for gate in undecided if gate.against is Against.RATIO]
    limits: dict[str, float] = {}
    for metric, statistic in dict.fromkeys(pair for pair in judged for pair in ((pair[0], "p50"), pair)):
        ratios = [
            change.smallest_ratio ** among_tests(change.degrees, 1, comparison.options.confidence)
            for _, change in comparison.changes_of(metric, statistic)
            if change.smallest_ratio is not None and change.degrees is not None
        ]
        limits |= {f"{metric}_{statistic}": max(ratios)} if ratios else {}
    parts = [
        f"no limit of {name}" if ratio > MOST_RATIO else f"{name} > +{math.ceil(100 * (ratio - 1))}%"
        for name, ratio in limits.items()
    ]
    return [f"Such runs decide {joined(parts)} (equal sides pass in 8 of 10 comparisons)."] if parts else []


def _labels(frames: Sequence[pl.DataFrame]) -> tuple[str, ...]:
    filled = {
        **dict.fromkeys(SERIES_COLUMNS),
        **dict.fromkeys(("vendor", "ping_device", "connectivity"), "any"),
        "bridge": "none",
        "setting": "",
        "published": 0,
        "received": 0,
    }
    rows = [{**filled, **row} for frame in frames for row in frame.to_dicts()]
    for row in rows:
        row["domain_mode"] = row["domain_mode"] or ("same" if row["bridge"] == "none" else "different")
    return tuple(group_labels(groups_of(rows, VendorLabels(VENDORS))).values())


def _groups(comparison: Comparison, labels: Sequence[str]) -> tuple[ComparedGroup, ...]:
    match = comparison.options.match
    changes, distributions = (
        frame.partition_by(match, as_dict=True, maintain_order=True) if len(frame) else {}
        for frame in (comparison.rows, comparison.distributions)
    )
    judged: dict[int | None, list[Judgement]] = {}
    for row in comparison.judgements:
        judged.setdefault(row.group, []).append(row)
    groups = []
    for number, (label, delivery) in enumerate(zip(labels, comparison.delivery.to_dicts(), strict=True)):
        key = tuple(delivery[name] for name in match)
        whole, *rows = judged[number]
        groups.append(
            ComparedGroup(
                label=label,
                verdict=whole.verdict,
                judged=tuple(rows),
                delivery=delivery,
                changes=tuple(changes[key].to_dicts()),
                distributions=tuple(distributions[key].to_dicts()),
                unlike="" if delivery["environment"] in (SAME, UNKNOWN) else str(delivery["environment"]),
            )
        )
    return tuple(sorted(groups, key=_rank))


def _rank(group: ComparedGroup) -> tuple[int, float]:
    most = max((row.value for row in group.times(shown=True) if row.value is not None), default=0.0)
    if group.verdict == "loses more":
        most = -(group.judged[0].value or 0.0)
    return WORST_FIRST.index(group.verdict), -most


def _answer(groups: Sequence[ComparedGroup], *, is_whole: bool, fails: bool) -> tuple[str, ...]:
    """Return the headline, and where the largest changes are; none where only a gate proves a change."""
    losing, worst = ([group for group in groups if group.verdict in WORST_FIRST[:most]] for most in (2, 3))
    keeping = [group for group in groups if group.delivery["verdict"] == "better"]
    keeping.sort(key=lambda group: -(group.delivery["difference"] or 0.0))
    worse = [*_lost_words(groups, losing, "more is lost"), *_times_words(groups, "slower")]
    if worst and not worse:
        worse = [("slower", len(worst), "as messages were lost")]
    better = [*_lost_words(groups, keeping, "less is lost"), *_times_words(groups, "faster")]
    best = [group for group in groups if group.verdict == "faster"]
    if best and not better:
        better = [("faster", len(best), "as messages of the base were lost")]
    changes = [*worse, *better]
    if not changes:
        if all(group.verdict == "too few runs" for group in groups):
            return (f"No verdict is possible: it needs {MIN_RUNS} runs a side.",)
        several = f"No result is proven to be slower or faster, of {len(groups)}."
        return ("" if fails else several if len(groups) > 1 else "No change is proven.",)
    several = f" of {counted(len(groups), 'result')}"
    words = ", ".join(
        f"{word} in {count}{'' if number else several}" if len(groups) > 1 else f"{word} ({most})"
        for number, (word, count, most) in enumerate(changes)
    )
    headline = f"{words[0].upper()}{words[1:]}.{' No regression.' if is_whole and not worse else ''}"
    return headline, *([f"Most: {'; '.join(most for *_, most in changes)}."] if len(groups) > 1 else [])


def _place(words: str, group: ComparedGroup, groups: Sequence[ComparedGroup]) -> str:
    return f"{words} in {group.label}" if len(groups) > 1 else words


def _lost_words(
    groups: Sequence[ComparedGroup], changed: Sequence[ComparedGroup], word: str
) -> list[tuple[str, int, str]]:
    return [
        (word, len(changed), _place(f"received {received_words(group.delivery)}", group, groups))
        for group in changed[:1]
    ]


def _times_words(groups: Sequence[ComparedGroup], word: str) -> list[tuple[str, int, str]]:
    # A percentile that was lost is part of the losses.
    verdict, sign = ("worse", 1) if word == "slower" else ("better", -1)
    changed = [
        (row, group)
        for group in groups
        for row in group.times()
        if row.verdict == verdict and row.value and math.isfinite(row.value)
    ]
    if not changed:
        return []
    shown = [pair for pair in changed if pair[0] in pair[1].times(shown=True)]
    row, most = max(shown or changed, key=lambda pair: sign * (pair[0].value or 0.0))
    metric, statistic = METRIC_AND_STATISTIC[row.statistic]
    what = f"{statistic_words(statistic)} of the {metric_words(metric).lower()} {change_words(row.value)}"
    return [(word, len({group.label for _, group in changed}), _place(what, most, groups))]


def _seen(sights: Sequence[DetectableChange], groups: Sequence[ComparedGroup], labels: Sequence[str]) -> str:
    # Where each result is slower or faster, no change was missed.
    times = [row for group in groups for row in group.times(shown=True)]
    open_ones = {row.statistic for row in times if row.verdict not in ("worse", "better")}
    shown = {row.statistic for row in groups[0].times(shown=True)} & open_ones
    visible = [sight for sight in sights if f"{sight.metric}_{sight.statistic}" in shown]
    parts = [
        f"of {with_article(sight.statistic)} {_range_words(sight, labels)}"
        for sight in visible
        if sight.smallest_ratio is not None and sight.smallest_ratio <= MOST_RATIO
    ]
    unclear = [
        f"{with_article(sight.statistic)} in {sight.groups - sight.told} of {counted(sight.groups, 'result')}"
        for sight in visible
        if sight.told < sight.groups
    ]
    unjudged = [
        sight.statistic for sight in visible if sight.smallest_ratio is not None and sight.smallest_ratio > MOST_RATIO
    ]
    sentences = [f"Such runs find in {100 * POWER:.0f} of 100 comparisons a change {'; '.join(parts)}"] if parts else []
    if parts and unclear:
        sentences[0] += f"; there is no verdict on {' and '.join(unclear)}"
    sentences += unjudged_words(unjudged)
    return "".join(f"{sentence[0].upper()}{sentence[1:]}. " for sentence in sentences).rstrip()


def _range_words(sight: DetectableChange, labels: Sequence[str]) -> str:
    ends = [(sight.least_ratio, sight.least_result), (sight.smallest_ratio, sight.most_result)]
    words = [(f"from {change_words(ratio).removeprefix('+')} on", result) for ratio, result in ends]
    if words[0][0] == words[1][0]:
        return words[0][0]
    return ", ".join(words if result is None else f"{words} in {labels[result]}" for words, result in words)


def mean_change(groups: Sequence[ComparedGroup], statistic: str) -> float | None:
    rows = [row for group in groups for row in group.shown() if row["statistic"] == statistic]
    ratios = [row["ratio"] for row in rows if row["ratio"] is not None and 0 < row["ratio"] < math.inf]
    return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else None


def _unlike_words(unlike: Sequence[Unlike], ignore: Sequence[str]) -> str:
    differ = ", ".join(f"{column.column} ({column.base} against {column.new})" for column in unlike)
    sentences = [f"They differ in {differ}."] if differ else []
    sentences += [f"--ignore {','.join(ignore)} compares them without that."] if ignore else []
    return " ".join(sentences)


def _gates(
    comparison: Comparison, results: Sequence[GateResult], shared: Sequence[str], missing: Sequence[str]
) -> tuple[Gated, ...]:
    match, order = comparison.options.match, [GateOutcome.REGRESSED, GateOutcome.INCONCLUSIVE]
    only_base = zip(comparison.only_base.to_dicts(), missing, strict=True)
    labels = {group_words(row, match): label for row, label in only_base}

    def named(row: GateResult) -> str:
        label = labels.get(row.subject, row.subject) if row.group is None else shared[row.group]
        return printable(label, MAX_FINDING_CHARACTERS)

    gated = [Gated(named(result), result) for result in results]
    return tuple(
        sorted(gated, key=lambda gate: order.index(gate.result.outcome) if gate.result.outcome in order else 9)
    )


def comparison_notes(comparison: Comparison) -> tuple[str, ...]:
    unfinished = counted(sum(comparison.unfinished.values()), "run")
    left_out = f"{unfinished} did not finish; what has less than half of the messages of the longest run is left out."
    parts = (
        ("Sides", ["base {}, new side {}".format(*comparison.names)] if comparison.names else []),
        ("Not matched", comparison.ignored),
        ("Unlike settings" if comparison.order else "Measured in turns", comparison.interleaved),
        ("Unlike environments", comparison.environment),
        ("Order", [comparison.order] if comparison.order else []),
        ("Unfinished", [left_out] if any(comparison.unfinished.values()) else []),
        ("Without a verdict", dict.fromkeys(error.text for error in comparison.errors)),
        ("Without a verdict", [f"repeat {one.repeat} of {one.cell}: {one.reason}" for one in comparison.left_out]),
    )
    return tuple(f"{name}: {printable(text, MAX_FINDING_CHARACTERS)}" for name, texts in parts for text in texts)


def _rules(comparison: Comparison, *, gated: bool) -> tuple[str, ...]:
    within, share = map(format_ratio, (comparison.options.same_within, comparison.options.confidence))
    gates = f", gates by {GATE_FAMILY}" if gated else ""
    return (
        f"Changes and intervals ({share}) are of new / base; 'the same' is a result whose intervals here are within {within}.",
        "Lost messages count as later than any deadline.",
        f"A verdict needs at least {MIN_RUNS} runs per side.",
        *["Repeats count as independent; `analyze` tests that, and may name no winner."] * comparison.options.paired,
        f"Verdicts are adjusted for their number ({FAMILY}){gates}.",
    )
