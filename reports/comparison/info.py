"""A comparison in words: the answer, its results worst first, and what it rests on."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from dds_trace.analyzer.model.names import group_words
from dds_trace.analyzer.model.parameters import SERIES_COLUMNS
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.statistics.power import POWER
from dds_trace.analyzer.verdicts.compare import FAMILY, Comparison
from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.analyzer.verdicts.gates import FAMILY as GATE_FAMILY
from dds_trace.analyzer.verdicts.gates import GateResult, overall_outcome, varying_columns
from dds_trace.analyzer.verdicts.ignoring import columns_to_ignore, unlike_columns
from dds_trace.analyzer.verdicts.judgements import WORST_FIRST, shown_changes, verdict_of_result
from dds_trace.analyzer.verdicts.sides import SAME, UNKNOWN
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import counted

from ..book.groups import VENDORS, Cell, VendorLabels, group_labels, groups_of
from ..book.verdicts import received_words
from .words import MOST_RATIO, Gated, change_words, metric_words, statistic_words, unjudged_words, with_article

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import polars as pl

    from dds_trace.analyzer.run_statistics.change import DetectableChange

UNCHANGED = {"no clear change", "undecided", "too few runs", "the same"}


@dataclass(frozen=True, slots=True)
class ComparedGroup:
    label: str
    verdict: str
    where: str
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


@dataclass(frozen=True, slots=True)
class Unlike:
    column: str
    base: str
    new: str


@dataclass(frozen=True, slots=True)
class ComparisonInfo:
    """Contents of the reports of a comparison.

    Attributes:
        said: the answer, for people.
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

    said: str
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
    unlike = () if groups else tuple(Unlike(name, *values) for name, values in unlike_columns(*apart).items())
    ignore = () if groups else columns_to_ignore(*apart)
    return ComparisonInfo(
        said="Both sides are the same recordings: nothing can have changed."
        if comparison.same_recordings
        else _answer(groups)
        if groups
        else "The two sides have no result in common: there is nothing to compare.",
        seen=("" if comparison.same_recordings else _seen(sights, groups, shared))
        if groups
        else _unlike_words(unlike, ignore),
        groups=groups,
        metric=metric_words(comparison.options.metrics[0]),
        only_base=only_base,
        only_new=only_new,
        outcome=overall_outcome(result.outcome for result in results) if results else None,
        gates=_gates(comparison, results, shared, only_base),
        sights=sights,
        unlike=unlike,
        ignore=ignore,
        notes=comparison_notes(comparison),
        rules=_rules(comparison, gated=bool(results)),
    )


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
    return group_labels(groups_of(rows, VendorLabels(VENDORS)))


def _groups(comparison: Comparison, labels: Sequence[str]) -> tuple[ComparedGroup, ...]:
    match = comparison.options.match
    changes, distributions = (
        frame.partition_by(match, as_dict=True, maintain_order=True) if len(frame) else {}
        for frame in (comparison.rows, comparison.distributions)
    )
    groups = []
    for label, delivery in zip(labels, comparison.delivery.to_dicts(), strict=True):
        key = tuple(delivery[name] for name in match)
        rows = tuple(changes[key].to_dicts())
        verdict = verdict_of_result(delivery, rows, is_busier=key in comparison.busier)
        groups.append(
            ComparedGroup(
                label=label,
                verdict=verdict,
                where=_where(rows, {"slower": "worse", "faster": "better"}.get(verdict, "")),
                delivery=delivery,
                changes=rows,
                distributions=tuple(distributions[key].to_dicts()),
                unlike="" if delivery["environment"] in (SAME, UNKNOWN) else str(delivery["environment"]),
            )
        )
    return tuple(sorted(groups, key=_rank))


def _where(rows: Sequence[Mapping[str, Any]], verdict: str) -> str:
    judged = [row for row in rows if row["verdict"] == verdict]
    tested = [row for row in rows if row["metric"] == rows[0]["metric"] and row["p_value"] is not None]
    agreeing = [row for row in tested if row["verdict"] == verdict]
    if agreeing:
        if len(agreeing) == len(tested):
            return ""
        return ", ".join(statistic_words(row["statistic"]) for row in agreeing)
    return ", ".join(dict.fromkeys(metric_words(row["metric"]).lower() for row in judged))


def _rank(group: ComparedGroup) -> tuple[int, float]:
    ratios = [row["ratio"] for row in group.shown() if row["ratio"] is not None]
    most = max(ratios, default=0.0)
    if group.verdict == "loses more":
        most = -(group.delivery["difference"] or 0.0)
    return WORST_FIRST.index(group.verdict), -most


def _answer(groups: Sequence[ComparedGroup]) -> str:
    several, count = len(groups) > 1, counted(len(groups), "result")
    counts = Counter(group.verdict for group in groups)
    parts = []
    losing = [group for group in groups if group.verdict in WORST_FIRST[:2]]
    if losing:
        where = f", most in {losing[0].label}" if several else ""
        parts.append(f"more is lost in {len(losing)} of {count}{where} ({received_words(losing[0].delivery)})")
    # A percentile that was lost is part of the losses.
    slower = [
        (row, group)
        for group in groups
        for row in group.changes
        if row["verdict"] == "worse" and row["ratio"] is not None and math.isfinite(row["ratio"])
    ]
    if slower:
        shown = [pair for pair in slower if pair[0] in pair[1].shown()]
        row, worst = max(shown or slower, key=lambda pair: pair[0]["ratio"])
        where = f" in {worst.label}" if several else ""
        what = f"{statistic_words(row['statistic'])} of the {metric_words(row['metric']).lower()}"
        results = len({group.label for _, group in slower})
        parts.append(f"slower in {results} of {count}, most the {what}{where}: {change_words(row['ratio'])}")
    elif counts["too few runs"] == len(groups):
        parts.append(f"no verdict is possible: it needs {MIN_RUNS} runs a side")
    else:
        parts.append(f"nothing is shown to be slower in {count}")
    parts += [f"{counts['faster']} faster"] if counts["faster"] else []
    sentence = "; ".join(parts)
    return f"{sentence[0].upper()}{sentence[1:]}."


def _seen(sights: Sequence[DetectableChange], groups: Sequence[ComparedGroup], labels: Sequence[str]) -> str:
    shown = {(row["metric"], row["statistic"]) for row in groups[0].shown()}
    # Where each result is slower or faster, no change was missed.
    proven = ("worse", "better")
    open_ones = {row["statistic"] for group in groups for row in group.shown() if row["verdict"] not in proven}
    visible = [sight for sight in sights if (sight.metric, sight.statistic) in shown and sight.statistic in open_ones]
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
    match = comparison.options.match
    labels = {
        group_words(row, names): label
        for frame, names, columns in (
            (comparison.delivery, varying_columns(comparison), shared),
            (comparison.only_base, match, missing),
        )
        for row, label in zip(frame.to_dicts(), columns, strict=True)
    }
    order = [GateOutcome.REGRESSED, GateOutcome.INCONCLUSIVE]

    def named(where: str) -> str:
        words = max((words for words in labels if where.startswith(words)), key=len, default="")
        return f"{labels[words]}{where.removeprefix(words)}" if words else where

    gated = [Gated(printable(named(result.where), MAX_FINDING_CHARACTERS), result) for result in results]
    return tuple(
        sorted(gated, key=lambda gate: order.index(gate.result.outcome) if gate.result.outcome in order else 9)
    )


def comparison_notes(comparison: Comparison) -> tuple[str, ...]:
    unfinished = counted(sum(comparison.unfinished.values()), "run")
    left_out = f"{unfinished} did not finish; what has less than half of the messages of the longest run is left out."
    parts = (
        ("Not matched", comparison.ignored),
        ("Measured in turns", comparison.interleaved),
        ("Unlike environments", comparison.environment),
        ("Order", [comparison.order] if comparison.order else []),
        ("Unfinished", [left_out] if any(comparison.unfinished.values()) else []),
        ("Not judged", dict.fromkeys(error.text for error in comparison.errors)),
        ("Not judged", [f"repeat {one.repeat} of {one.cell}: {one.reason}" for one in comparison.left_out]),
    )
    return tuple(f"{name}: {printable(text, MAX_FINDING_CHARACTERS)}" for name, texts in parts for text in texts)


def _rules(comparison: Comparison, *, gated: bool) -> tuple[str, ...]:
    within, share = f"{comparison.options.same_within:.0%}", f"{100 * comparison.options.confidence:.3g}%"
    gates = f", gates by {GATE_FAMILY}" if gated else ""
    return (
        f"Changes and intervals ({share}) are of new / base; 'the same' is a result whose intervals here are within {within}.",
        "A lost message is infinitely late.",
        f"The run is the unit: a verdict needs {MIN_RUNS} runs a side.",
        f"Verdicts are adjusted for their number ({FAMILY}){gates}.",
        "A smaller change than the one that a result finds in 80 of 100 comparisons may be found, too, less often.",
    )
