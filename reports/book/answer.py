"""The answer in words, as far as the verdicts support it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import polars as pl

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, PROVEN, Claim, Judgement, Reason
from dds_trace.base.units import counted, format_duration, format_ratio, joined

from .fastest import ALIKE, Fastest, lowest_sentence, tail_sentence, winner_sentences
from .groups import (
    LOST,
    METRIC_LABELS,
    Group,
    Groups,
    VendorLabels,
    data_type_label,
    domain_label,
    factor_words,
    format_count,
    group_labels,
    in_domain,
    is_of_topics,
    some_of,
    time_words,
    topic_parts,
)
from .headline import bridge_sentence, interference_sentences, limits_words, recovery_sentences, where_sentence
from .losses import (
    MACHINE,
    UNREACHED,
    avoid_sentence,
    cause_sentence,
    cure_sentence,
    few_lost_sentence,
    found_sentence,
    loss_sentence,
    replaces,
    throughput_sentence,
)
from .numbers import Median, Values, shown_medians
from .sizes import late_by_group, late_share
from .verdicts import CLEARLY, FEW_PASSES, WITHIN_ONE_RUN, DataVerdict, contender_labels, verdicts_info


class PointKind(str, Enum):
    FORGED = "forged"
    RECOVERY = "recovery"
    INTERFERENCE = "interference"
    LOSS = "loss"
    CAUSE = "cause"
    AVOID = "avoid"
    CURE = "cure"
    FEW_LOST = "few lost"
    THROUGHPUT = "throughput"
    FASTEST = "fastest"
    UNDECIDED = "undecided"
    CLIENT_FLOOR = "client floor"
    DOUBT = "doubt"
    TAIL = "tail"
    FLOOR = "floor"
    PLACE = "place"
    BRIDGE = "bridge"
    WHERE = "where"
    TOPIC = "topic"
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class Conclusion:
    """Headline and sentences of a report; `points` follow the headline, `remarks` are numbers, `rule` defines `clearly`.

    `outcome` is `decided`, `open`, or `lossy` where a report advises against a setup; empty where the headline is of few losses.
    `kinds` are of the headline and each of the points.
    """

    headline: str
    metric: str
    verdicts: tuple[DataVerdict, ...]
    remarks: tuple[str, ...]
    rule: str
    points: tuple[str, ...] = ()
    outcome: str = ""
    kinds: tuple[PointKind, ...] = (PointKind.NOTHING,)

    @property
    def sentences(self) -> list[tuple[PointKind, str]]:
        return [*zip(self.kinds, (self.headline, *self.points), strict=True)]


def answer_info(analysis: Analysis, groups: Groups, values: Values, fastest: Sequence[Fastest]) -> Conclusion:
    metric, medians = values.default_metric, shown_medians(analysis, groups, values)
    topics = topic_parts(analysis, "topic_sentences")
    if not groups.groups or is_of_topics(analysis):
        limits = [limits_words(analysis)] if topics else []
        headline, *points = [*topics, *filter(None, limits)] or ["No measurement was found."]
        kinds = (PointKind.TOPIC if topics else PointKind.NOTHING,) * (1 + len(points))
        return Conclusion(headline, metric, (), (), "", tuple(points), kinds=kinds)
    if not values.has(metric):
        headline = "No message was received, so there is no time to compare."
        return Conclusion(headline, metric, (), (loss_sentence(groups, values),), "", kinds=(PointKind.LOSS,))
    # Answers compare latencies, which need the relay's trace.
    has_latency = metric == "latency"
    answers = analysis.details.answers if has_latency else ()
    costs = analysis.details.bridge_costs if has_latency else analysis.details.bridge_costs.clear()
    cures = {group: finding.cure for finding in analysis.findings if finding.cure for group in finding.groups}
    busy = {group for finding in analysis.findings if finding.code in MACHINE for group in finding.groups}
    forged = analysis.unusable_groups
    usable = replace(groups, groups=tuple(group for group in groups.groups if group.index not in forged))
    losses, unreached = loss_sentence(usable, values), found_sentence(analysis, groups, UNREACHED)
    replaced = [group for group in usable.groups if group.received < group.published and replaces(usable, group)]
    remarks = (
        *_deadline_remarks(analysis, groups),
        *[
            f"{_without_latency(groups)}: the latency is unknown, and the {METRIC_LABELS[metric].lower()} below includes the time in the relay."
        ]
        * (not has_latency),
        *_level_remarks(usable, medians),
        *([] if losses or forged or unreached or replaced else ["Every message was received."]),
    )
    verdicts = verdicts_info(answers, groups.vendors)
    judged = analysis.judgements if has_latency else analysis.judgements.clear()
    rule = CLEARLY if any(verdict.within_one_run < verdict.cells for verdict in verdicts) else WITHIN_ONE_RUN
    if any(answer.clarity is Clarity.CLEAR and answer.fewest_runs == MIN_RUNS for answer in answers):
        rule += FEW_PASSES
    first, *others = _who_is_fastest(fastest, usable, medians, answers) if usable.groups else [(PointKind.NOTHING, "")]
    own_nodes = own_nodes_sentence(judged, contender_labels(answers, groups.vendors))
    doubts = ((PointKind.DOUBT, limits_words(analysis)), (PointKind.CLIENT_FLOOR, own_nodes))
    sentences = [
        *((PointKind.TOPIC, text) for text in topics),
        (PointKind.FORGED, found_sentence(analysis, groups)),
        *((PointKind.RECOVERY, text) for text in recovery_sentences(analysis, usable)),
        *((PointKind.INTERFERENCE, text) for text in interference_sentences(analysis, usable)),
        (PointKind.LOSS, losses),
        (PointKind.CAUSE, cause_sentence(analysis, usable) if losses else ""),
        (PointKind.AVOID, avoid_sentence(answers, groups.vendors, cures, busy)),
        (PointKind.CURE, cure_sentence(usable, cures)),
        *(doubts if losses else ()),
        (PointKind.THROUGHPUT, throughput_sentence(usable, values)),
        first,
        *(() if losses else doubts),
        (PointKind.PLACE, place_sentence(judged)),
        *others,
        (PointKind.BRIDGE, bridge_sentence(costs, groups.vendors)),
        (PointKind.WHERE, where_sentence(analysis, groups, values)),
        (PointKind.FEW_LOST, few_lost_sentence(answers, groups.vendors)),
        (PointKind.FEW_LOST, unreached),
    ]
    kinds, (headline, *points) = zip(*[(kind, text) for kind, text in sentences if text], strict=True)
    is_decided = any(kind.is_decided for kind in fastest)
    is_lossy = PointKind.FORGED in kinds or any(
        row.verdict == DO_NOT_USE for answer in answers for row in answer.of_claim(Claim.LOSSY)
    )
    outcome = "lossy" if is_lossy else "" if PointKind.LOSS in kinds else "decided" if is_decided else "open"
    return Conclusion(headline, metric, verdicts, remarks, rule if verdicts else "", tuple(points), outcome, kinds)


def _who_is_fastest(
    fastest: Sequence[Fastest], groups: Groups, medians: Mapping[int, Median], answers: Sequence[CaseAnswer]
) -> list[tuple[PointKind, str]]:
    floors = [group for group in groups.groups if groups.series_of(group).backend == "socket"]
    is_timed = len(floors) < len(groups.groups) and any(group.index in medians for group in floors)
    floor = (
        PointKind.FLOOR,
        f"Plain sockets, {_floor_words(floors, groups, medians)}: {_span(floors, medians)}." if is_timed else "",
    )
    if any(kind.is_decided for kind in fastest):
        winners = [(PointKind.FASTEST, text) for text in winner_sentences(fastest)]
        return [*winners, (PointKind.TAIL, tail_sentence(answers, contender_labels(answers, groups.vendors))), floor]
    return [*((PointKind.UNDECIDED, text) for text in _why_undecided(fastest, groups, medians, answers)), floor]


def _floor_words(floors: Sequence[Group], groups: Groups, medians: Mapping[int, Median]) -> str:
    def message(group: Group) -> tuple[int, str]:
        return group.cell, domain_label(groups.series_of(group))

    floor_ns = {message(group): medians[group.index].ns for group in floors if group.index in medians}
    faster = {
        groups.series_of(group).vendor_label
        for group in groups.groups
        if group not in floors and group.index in medians and medians[group.index].ns < floor_ns.get(message(group), 0)
    }
    return f"the floor but where {joined(sorted(faster))} took less" if faster else "the floor"


def own_nodes_sentence(judged: pl.DataFrame, labels: Mapping[str, str]) -> str:
    compared = judged.filter(claim=Claim.OWN_NODES.value)
    below = compared.filter(verdict=PROVEN)
    if below.is_empty():
        return ""
    pairs = [
        (labels[fast], labels[slow.partition(";")[0]]) for slow, fast in below.select("subject", "base").iter_rows()
    ]
    parts = [f"{fast} before {slow} in {count}" for (fast, slow), count in Counter(pairs).most_common()]
    return (
        f"{below.height} of {counted(compared.height, 'proven difference')} may be our Python, not the middleware, as our own nodes "
        f"cost more than that on the slower side (`own_cost_ns`): {joined(parts)}."
    )


def _why_undecided(
    fastest: Sequence[Fastest], groups: Groups, medians: Mapping[int, Median], answers: Sequence[CaseAnswer]
) -> list[str]:
    if fastest:
        return _no_winner(answers, groups.vendors)
    others = [group for group in groups.groups if groups.series_of(group).backend != "socket"] or groups.groups
    vendors = sorted({groups.series_of(group).vendor_label for group in others})
    if len(vendors) == 1:
        return [f"{_levels(others, groups, medians)}.", "No other middleware was measured."]
    why = "One middleware per setting was measured, so there is no ranking."
    if not answers:
        needs = "the rows of all messages" if "latency" in _of(others, medians) else "the relay's trace"
        why = f"{joined(vendors)} are not ranked, because that needs {needs}."
    return [why, f"{_levels(others, groups, medians)}."]


def _no_winner(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> list[str]:
    reasons: dict[str, list[tuple[Judgement, CaseAnswer]]] = {}
    for answer in answers:
        for row in answer.of_claim(Claim.FASTEST, "latency_p50"):
            if row.reason not in (Reason.NONE.value, Reason.ONLY_ONE.value):
                reasons.setdefault(row.reason, []).append((row, answer))
    labels = contender_labels(answers, vendors)
    total = sum(map(len, reasons.values()))
    where = "" if total == 1 else f" in any of {total} comparisons"
    lowest = lowest_sentence([pair for judged in reasons.values() for pair in judged], labels)
    if len(reasons) == 1:
        ((reason, judged),) = reasons.items()
        return [f"No proven winner{where}: {_WHY[Reason(reason)](judged, labels)}.", lowest]
    parts = [
        f"In {len(judged)} of them {_WHY[Reason(reason)](judged, labels)}."
        for reason, judged in sorted(reasons.items(), key=lambda item: -len(item[1]))
    ]
    return [f"No proven winner{where}.", lowest, " ".join(parts)]


def _near(judged: Sequence[tuple[Judgement, CaseAnswer]], labels: Mapping[str, str]) -> str:
    row, _ = max(judged, key=lambda pair: pair[0].value or 0.0)
    ends = "" if row.low is None or row.high is None else f" ({change_percent(row.low)} to {change_percent(row.high)})"
    most = "" if len(judged) == 1 else "at most "
    lead = f"{labels[row.subject]} leads {labels[row.base]} by {most}{change_percent(row.value or 1.0)}{ends}"
    return f"the measured lead is below the margin ({lead}; --margin)"


def change_percent(ratio: float) -> str:
    return f"{100 * (ratio - 1):.3g} %"


def _few_runs(judged: Sequence[tuple[Judgement, CaseAnswer]], _: Mapping[str, str]) -> str:
    fewest, *more = sorted({answer.fewest_runs for _, answer in judged})
    if fewest >= MIN_RUNS:
        return f"a verdict needs {MIN_RUNS} runs with a latency of each"
    runs = f"{fewest} to {more[-1]}" if more else fewest
    return f"a verdict needs {MIN_RUNS} runs of each, there {'is' if runs == 1 else 'are'} {runs}"


_WHY: Mapping[Reason, Callable[[Sequence[tuple[Judgement, CaseAnswer]], Mapping[str, str]], str]] = {
    Reason.NOT_SHOWN: lambda *_: "a test of the runs shows no setup to be faster than the others",
    Reason.BELOW_MARGIN: _near,
    Reason.IN_SEQUENCE: lambda *_: (
        "the setups were recorded one after the other (interleave them, or give --trust-order)"
    ),
    Reason.DEPENDENT: lambda *_: f"{ALIKE}, so the passes count for less than their number",
    Reason.FEW_RUNS: _few_runs,
    Reason.LOSSES: lambda *_: "the fastest one loses too much",
}
"""Reason without a winner -> words for rows with it."""


_MOST_WAYS = 3


def _levels(chosen: Sequence[Group], groups: Groups, medians: Mapping[int, Median]) -> str:
    names = {groups.series_of(group).vendor_label for group in chosen}
    ways: dict[tuple[str, str], list[Group]] = {}
    for group in sorted(chosen, key=lambda group: group.series):
        if group.index in medians:
            series = groups.series_of(group)
            ways.setdefault((series.vendor_label, in_domain(domain_label(series))), []).append(group)
    has_ways = len({way for _, way in ways}) > 1
    spans = []
    for (vendor, way), same in list(ways.items())[: None if len(names) > 1 else _MOST_WAYS]:
        cell = f"({groups.cell_of(same[0]).label})" if len(names) > 1 and len(same) == 1 else ""
        tails = f"({_tails(same, medians)})" if has_ways and len(names) == 1 and _tails(same, medians) else ""
        parts = (vendor if len(names) > 1 else "", _span(same, medians), tails or cell, way if has_ways else "")
        spans.append(" ".join(filter(None, parts)))
    if not spans:
        return f"{joined(sorted(names))}: no message came back"
    what = f"edian {_of(chosen, medians)}"
    if len(names) > 1:
        return f"M{what}: {joined(spans)}"
    tails = "" if has_ways else _tails(chosen, medians)
    return f"{names.pop()}: m{what} {', '.join(filter(None, (joined(spans), tails)))}"


def _tails(groups: Iterable[Group], medians: Mapping[int, Median]) -> str:
    tails_ns = [ns for group in groups if group.index in medians and (ns := medians[group.index].p99_ns) is not None]
    return f"p99 {' to '.join(dict.fromkeys(time_words(end(tails_ns)) for end in (min, max)))}" if tails_ns else ""


def _span(groups: Iterable[Group], medians: Mapping[int, Median]) -> str:
    times_ns = sorted(medians[group.index].ns for group in groups if group.index in medians)
    finite_ns = [ns for ns in times_ns if math.isfinite(ns)]
    lost = len(times_ns) - len(finite_ns)
    if not finite_ns:
        return LOST
    words = " to ".join(dict.fromkeys(_median(end) for end in (finite_ns[0], finite_ns[-1])))
    return f"{words} ({LOST} in {lost} of {counted(len(times_ns), 'result')})" if lost else words


def _of(groups: Iterable[Group], medians: Mapping[int, Median]) -> str:
    of = dict.fromkeys(medians[group.index].of for group in groups if group.index in medians)
    received = {words.replace("all received", "all") for words in of if "received" in words}
    return joined(words for words in of if words not in received)


def _median(time_ns: float) -> str:
    return time_words(time_ns) if time_ns else "below the clock's step"


def _level_remarks(groups: Groups, medians: Mapping[int, Median]) -> list[str]:
    remarks, labels = [], group_labels(groups)
    for data_type in dict.fromkeys(cell.data_type for cell in groups.cells):
        same = [g for g in groups.groups if groups.cell_of(g).data_type == data_type and g.index in medians]
        ordered = sorted(same, key=lambda group: (medians[group.index].ns, group.index))
        finite = [group for group in ordered if math.isfinite(medians[group.index].ns)] or ordered
        if finite:
            name, ends = data_type_label(data_type), {group.index: group for group in (finite[0], finite[-1])}.values()
            spans = [f"{_span([end], medians)} ({labels[end.index].removeprefix(name).strip()})" for end in ends]
            lost = [labels[group.index] for group in ordered if group not in finite]
            more = f"; the median message is lost in {some_of(lost, 'more')}" if lost else ""
            remarks.append(f"{name}: median {_of(ends, medians)} {' to '.join(spans)}{more}.")
    return remarks


_DEADLINE_LABELS = {"response": "response (planned send to reply)", "outbound": "way out", "return": "way back"}


def _deadline_remarks(analysis: Analysis, groups: Groups) -> list[str]:
    details, late = analysis.details, late_by_group(analysis)
    if not late:
        return []
    missed, judged, unsure = map(sum, zip(*late.values(), strict=True))
    label = _DEADLINE_LABELS.get(details.deadline_metric) or METRIC_LABELS[details.deadline_metric].lower()
    share = f" ({format_ratio(missed / judged)})" if missed else ""
    remark = (
        f"Deadline of {format_duration(details.deadline_ns)} for the {label}: "
        f"{format_count(missed)} of {counted(judged, 'message')} missed it{share}"
    )
    if missed and len(late) > 1:
        worst = max(sorted(late), key=lambda group: late_share(*late[group]))
        remark += f", the largest share in {group_labels(groups)[worst]} ({format_ratio(late_share(*late[worst]))} of its messages)"
    if unsure:
        remark += f". {counted(unsure, 'more message')} may have, within the clock bound"
    return [f"{remark}."]


def _without_latency(groups: Groups) -> str:
    has_trace = any(series.relay_device is not None for series in groups.series)
    return "No reply has a relay's time stamps" if has_trace else "No relay's trace was found"


MOST_COMPARED = 3


def place_sentence(judged: pl.DataFrame) -> str:
    parts = []
    for claim in (Claim.OVER, Claim.FROM, Claim.ON):
        words, preposition = [], claim.value.rpartition(" ")[2]
        compared = judged.filter(claim=claim.value)
        for (name,), rows in compared.group_by("subject", maintain_order=True):
            factors = rows.filter(verdict=PROVEN)["value"].to_list()
            unclear = f" (no clear difference in {rows.height - len(factors)} of {rows.height} comparisons)"
            if factors:
                noted = unclear if len(factors) < rows.height else ""
                words.append(f"{preposition} {name} {factor_words(factors)} as long{noted}")
        if words:
            parts.append(f"{joined(words[:MOST_COMPARED])} as {preposition} {compared['base'][0]}")
    return f"At the median a message takes {'; '.join(parts)}." if parts else ""
