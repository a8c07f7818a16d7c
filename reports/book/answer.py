"""The answer in words, as far as the verdicts support it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.judgements import PROVEN, Claim, Judgement, Reason
from dds_trace.base.units import counted, format_duration, format_ratio, joined

from .fastest import Fastest, tail_sentence, winner_sentences
from .groups import (
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
    topic_parts,
)
from .headline import bridge_sentence, interference_sentences, limits_words, recovery_sentences, where_sentence
from .losses import UNREACHED, avoid_sentence, cure_sentence, few_lost_sentence, found_sentence, loss_sentence
from .numbers import Values
from .sizes import late_by_group, late_share
from .verdicts import CLEARLY, FEW_PASSES, WITHIN_ONE_RUN, DataVerdict, contender_labels, verdicts_info

if TYPE_CHECKING:
    import polars as pl


class PointKind(str, Enum):
    FORGED = "forged"
    RECOVERY = "recovery"
    INTERFERENCE = "interference"
    LOSS = "loss"
    AVOID = "avoid"
    CURE = "cure"
    FEW_LOST = "few lost"
    FASTEST = "fastest"
    UNDECIDED = "undecided"
    CLIENT_FLOOR = "client floor"
    TAIL = "tail"
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
    metric = values.default_metric
    topics = topic_parts(analysis, "topic_sentences")
    if not groups.groups or is_of_topics(analysis):
        limits = [limits_words(analysis).strip()] if topics else []
        headline, *points = [*topics, *filter(None, limits)] or ["No measurement was found."]
        kinds = (PointKind.TOPIC if topics else PointKind.NOTHING,) * (1 + len(points))
        return Conclusion(headline, metric, (), (), "", tuple(points), "open" if topics else "", kinds)
    if not values.has(metric):
        headline = "No message was received, so there is no time to compare."
        return Conclusion(headline, metric, (), (loss_sentence(groups, values),), "", kinds=(PointKind.LOSS,))
    # Answers compare latencies, which need the relay's trace.
    has_latency = metric == "latency"
    answers = analysis.details.answers if has_latency else ()
    costs = analysis.details.bridge_costs if has_latency else analysis.details.bridge_costs.clear()
    cures = {group: finding.cure for finding in analysis.findings if finding.cure for group in finding.groups}
    forged = analysis.unusable_groups
    usable = replace(groups, groups=tuple(group for group in groups.groups if group.index not in forged))
    losses, unreached = loss_sentence(usable, values), found_sentence(analysis, groups, UNREACHED)
    remarks = (
        *_deadline_remarks(analysis, groups),
        *(
            []
            if has_latency
            else [f"{_WITHOUT_LATENCY}, and the {METRIC_LABELS[metric].lower()} below includes the time in the relay."]
        ),
        *_level_remarks(usable, values, metric),
        *([] if losses or forged or unreached else ["Every message was received."]),
    )
    verdicts, judged = verdicts_info(answers, groups.vendors), analysis.judgements
    rule = CLEARLY if any(verdict.within_one_run < verdict.cells for verdict in verdicts) else WITHIN_ONE_RUN
    if any(answer.clarity is Clarity.CLEAR and answer.fewest_runs == MIN_RUNS for answer in answers):
        rule += FEW_PASSES
    first, *others = _who_is_fastest(fastest, usable, values, answers) if usable.groups else [(PointKind.NOTHING, "")]
    sentences = [
        *((PointKind.TOPIC, text) for text in topics),
        (PointKind.FORGED, found_sentence(analysis, groups)),
        *((PointKind.RECOVERY, text) for text in recovery_sentences(analysis, usable)),
        *((PointKind.INTERFERENCE, text) for text in interference_sentences(judged, usable)),
        (PointKind.LOSS, losses),
        (PointKind.AVOID, avoid_sentence(answers, groups.vendors, cures)),
        (PointKind.CURE, cure_sentence(answers, groups.vendors, cures)),
        (PointKind.FEW_LOST, few_lost_sentence(answers, groups.vendors)),
        (PointKind.FEW_LOST, unreached),
        first,
        (
            PointKind.CLIENT_FLOOR,
            own_nodes_sentence(judged, contender_labels(answers, groups.vendors)) if has_latency else "",
        ),
        (PointKind.PLACE, place_sentence(judged) if has_latency else ""),
        *others,
        (PointKind.BRIDGE, bridge_sentence(costs, groups.vendors)),
        (PointKind.WHERE, where_sentence(analysis, groups, values)),
    ]
    kinds, (headline, *points) = zip(*[(kind, text) for kind, text in sentences if text], strict=True)
    is_decided = any(kind.is_decided for kind in fastest)
    is_lossy, loses = not {PointKind.AVOID, PointKind.FORGED}.isdisjoint(kinds), PointKind.LOSS in kinds
    outcome = "lossy" if is_lossy else "" if loses else "decided" if is_decided else "open"
    return Conclusion(headline, metric, verdicts, remarks, rule if verdicts else "", tuple(points), outcome, kinds)


def _who_is_fastest(
    fastest: Sequence[Fastest], groups: Groups, values: Values, answers: Sequence[CaseAnswer]
) -> list[tuple[PointKind, str]]:
    if any(kind.is_decided for kind in fastest):
        winners = [(PointKind.FASTEST, text) for text in winner_sentences(fastest)]
        return [*winners, (PointKind.TAIL, tail_sentence(answers))]
    return [(PointKind.UNDECIDED, text) for text in _why_undecided(fastest, groups, values, answers)]


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
    fastest: Sequence[Fastest], groups: Groups, values: Values, answers: Sequence[CaseAnswer]
) -> list[str]:
    if fastest:
        return _no_winner(answers, groups.vendors)
    vendors = sorted({groups.series_of(group).vendor_label for group in groups.groups})
    if len(vendors) == 1:
        return [_ways(vendors[0], groups, values), "No other middleware was measured."]
    if not answers:
        return [f"{joined(vendors)} were not compared, because that needs the rows of all messages."]
    names = sorted(set(contender_labels(answers, groups.vendors).values()))
    return [f"{joined(names)} were not measured under equal conditions, so they are not compared."]


def _no_winner(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> list[str]:
    reasons: dict[str, list[tuple[Judgement, CaseAnswer]]] = {}
    for answer in answers:
        for row in answer.of_claim(Claim.FASTEST, "latency_p50"):
            if row.reason not in (Reason.NONE.value, Reason.ONLY_ONE.value):
                reasons.setdefault(row.reason, []).append((row, answer))
    labels = contender_labels(answers, vendors)
    total = sum(map(len, reasons.values()))
    where = "for the one message compared" if total == 1 else f"for any of the {total} kinds of message compared"
    if len(reasons) == 1:
        ((reason, judged),) = reasons.items()
        return [f"No clear winner {where}: {_WHY[Reason(reason)](judged, labels)}."]
    parts = [
        f"In {len(judged)} of them {_WHY[Reason(reason)](judged, labels)}."
        for reason, judged in sorted(reasons.items(), key=lambda item: -len(item[1]))
    ]
    return [f"No clear winner {where}.", " ".join(parts)]


def _near(judged: Sequence[tuple[Judgement, CaseAnswer]], labels: Mapping[str, str]) -> str:
    row, _ = max(judged, key=lambda pair: pair[0].value or 0.0)
    ends = "" if row.low is None or row.high is None else f" ({change_percent(row.low)} to {change_percent(row.high)})"
    most = "" if len(judged) == 1 else "at most "
    lead = f"{labels[row.subject]} leads {labels[row.base]} by {most}{change_percent(row.value or 1.0)}{ends}"
    return f"the lead is below the margin ({lead}; --margin)"


def change_percent(ratio: float) -> str:
    return f"{100 * (ratio - 1):.3g} %"


def _few_runs(judged: Sequence[tuple[Judgement, CaseAnswer]], _: Mapping[str, str]) -> str:
    fewest = min(answer.fewest_runs for _, answer in judged)
    return f"a verdict needs {MIN_RUNS} runs of each, there {'is' if fewest == 1 else 'are'} {fewest}"


_WHY: Mapping[Reason, Callable[[Sequence[tuple[Judgement, CaseAnswer]], Mapping[str, str]], str]] = {
    Reason.NOT_SHOWN: lambda *_: "a test of the runs shows no setup to be faster than the others",
    Reason.BELOW_MARGIN: _near,
    Reason.IN_SEQUENCE: lambda *_: (
        "the setups were recorded one after the other (interleave them, or give --trust-order)"
    ),
    Reason.DEPENDENT: lambda *_: "the passes depend on each other, so that they count for less than they are",
    Reason.FEW_RUNS: _few_runs,
    Reason.LOSSES: lambda *_: "the fastest one loses too much",
}
"""Reason without a winner -> words for rows with it."""


_MOST_WAYS = 3


def _ways(vendor: str, groups: Groups, values: Values) -> str:
    metric = values.default_metric
    ways: dict[str, list[int]] = {}
    for group in sorted(groups.groups, key=lambda group: group.series):
        median_ns = values.times_ns[metric]["p50"][group.index]
        if median_ns is not None:
            ways.setdefault(domain_label(groups.series_of(group)), []).append(median_ns)
    spans = {
        way: " to ".join(dict.fromkeys(_median(end) for end in (min(medians_ns), max(medians_ns))))
        for way, medians_ns in ways.items()
    }
    what = f"{vendor}: median {METRIC_LABELS[metric].lower()} of all {_messages(groups.groups, values)}"
    if len(spans) == 1:
        return f"{what} {next(iter(spans.values()))}."
    return f"{what} {joined(f'{span} {in_domain(way)}' for way, span in list(spans.items())[:_MOST_WAYS])}."


def _median(time_ns: float) -> str:
    return format_duration(time_ns) if time_ns else "below the clock's step"


def _messages(groups: Iterable[Group], values: Values) -> str:
    unsent = values.plain["unsent"]
    is_whole = all(group.received == group.published and not unsent[group.index] for group in groups)
    return "messages" if is_whole else "received messages"


def _level_remarks(groups: Groups, values: Values, metric: str) -> list[str]:
    remarks, labels = [], group_labels(groups)
    for data_type in dict.fromkeys(cell.data_type for cell in groups.cells):
        medians = sorted(
            (median, group.index)
            for group in groups.groups
            if groups.cell_of(group).data_type == data_type
            and (median := values.times_ns[metric]["p50"][group.index]) is not None
        )
        if not medians:
            continue
        name = data_type_label(data_type)
        ends = dict.fromkeys((medians[0], medians[-1]))
        spans = [f"{_median(ns)} ({labels[index].removeprefix(name).strip()})" for ns, index in ends]
        whose = _messages((groups.groups[index] for _, index in ends), values)
        remarks.append(f"{name}: median {METRIC_LABELS[metric].lower()} of all {whose} {' to '.join(spans)}.")
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
        f"{format_count(missed)} of {counted(judged, 'message', text=format_count(judged))} missed it{share}"
    )
    if missed and len(late) > 1:
        worst = max(sorted(late), key=lambda group: late_share(*late[group]))
        remark += f", the largest share in {group_labels(groups)[worst]} ({format_ratio(late_share(*late[worst]))} of its messages)"
    if unsure:
        more = counted(unsure, "more message", text=format_count(unsure))
        remark += f". {more} may have, within the clock bound"
    return [f"{remark}."]


_WITHOUT_LATENCY = "No relay's trace was found: the latency is unknown"


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
