"""The answer in words: which middleware and bridge suit which data, as far as the intervals support a choice."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import polars as pl

from dds_trace.analyzer.model.setting import condition_of
from dds_trace.analyzer.statistics.intervals import MIN_RUNS, Basis
from dds_trace.base.units import counted, format_duration

from .groups import (
    METRIC_LABELS,
    data_type_label,
    domain_label,
    format_added_ns,
    format_count,
    format_ratio,
    group_labels,
    way_words,
)
from .headline import avoid_sentence, bridge_sentence, loss_sentence, where_sentence, winner_sentences
from .verdicts import (
    CLEARLY,
    WITHIN_ONE_RUN,
    DataVerdict,
    combinations,
    contender_labels,
    place_label,
    verdicts_info,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from dds_trace.analyzer.analysis import Analysis, Details
    from dds_trace.analyzer.verdicts.answers import CaseAnswer

    from .groups import Group, Groups, VendorLabels
    from .numbers import Values


@dataclass(frozen=True, slots=True)
class Conclusion:
    """Headline and sentences of a report.

    Attributes:
        headline: the most important sentence.
        metric: metric of the remarks: latency, or the next one that was measured.
        verdicts: one per kind of data; empty if no contenders could be compared.
        remarks: sentences on the range of medians, the cost of bridges and the losses.
        rule: definition of `clearly`; empty if nothing was compared.
        points: the sentences that follow the headline: who is fastest, what not to use, what bridges cost, where.
    """

    headline: str
    metric: str
    verdicts: tuple[DataVerdict, ...]
    remarks: tuple[str, ...]
    rule: str
    points: tuple[str, ...] = ()


def answer_info(analysis: Analysis, groups: Groups, values: Values) -> Conclusion:
    """Derive headline, verdicts and remarks from `analysis.details`."""
    metric = values.default_metric
    if not groups.groups:
        return Conclusion("No measurement was found.", metric, (), (), "")
    if not values.has(metric):
        return Conclusion(
            "No message came back, so there is no time to compare.", metric, (), (_losses(values),), ""
        )
    # Answers compare latencies, which need the relay's trace.
    known = analysis.details if metric == "latency" else None
    answers = known.answers if known else ()
    verdicts = verdicts_info(answers, groups.vendors)
    bridges = _bridge_remarks(known.bridge_costs, groups.vendors) if known else []
    remarks = (
        *_deadline_remarks(analysis.details, groups),
        *_unknown_remarks(metric),
        *_level_remarks(groups, values, metric),
        *bridges,
        _losses(values),
    )
    rule = CLEARLY if any(one.within_one_run < one.cells for one in verdicts) else WITHIN_ONE_RUN
    sentences = (
        loss_sentence(groups, values),
        avoid_sentence(answers, groups.vendors),
        *_who_is_fastest(verdicts, groups, values, answers),
        bridge_sentence(known.bridge_costs, groups.vendors) if known else "",
        where_sentence(analysis, groups, values),
    )
    headline, *points = (sentence for sentence in sentences if sentence)
    return Conclusion(headline, metric, verdicts, remarks, rule if verdicts else "", tuple(points))


def _who_is_fastest(
    verdicts: tuple[DataVerdict, ...], groups: Groups, values: Values, answers: Sequence[CaseAnswer]
) -> tuple[str, ...]:
    vendors = sorted({series.vendor_label for series in groups.series})
    if not verdicts:
        if len(vendors) == 1:
            return (f"{_ways(vendors[0], groups, values)} No other middleware was measured.",)
        if not answers:
            return (f"{_and(vendors)} were not compared: that takes the rows of all messages.",)
        names = sorted(set(contender_labels(answers, groups.vendors).values()))
        return (
            f"{_and(names)} were not measured under equal conditions, so no choice can be made from this.",
        )
    if not any(verdict.wins for verdict in verdicts):
        return (_no_winner(verdicts, answers),)
    return winner_sentences(answers, groups.vendors)


def _no_winner(verdicts: Sequence[DataVerdict], answers: Sequence[CaseAnswer]) -> str:
    """Say that no choice can be made, and whether more runs are what that takes."""
    cells = sum(verdict.cells for verdict in verdicts)
    few = sum(verdict.within_one_run for verdict in verdicts)
    where = "the one combination" if cells == 1 else f"any of the {cells} combinations"
    if few < cells:
        said = f"No clear winner: no choice was faster than the others by a test of the runs, in {where} of data, size and rate compared."
        return f"{said} {few} of them had fewer than {MIN_RUNS} runs of each." if few else said
    fewest = min(answer.fewest_runs for answer in answers if len(answer.contenders) > 1)
    there = "is" if fewest == 1 else "are"
    return (
        f"No clear winner in {where} of data, size and rate compared: telling apart takes {MIN_RUNS} runs of each, "
        f"there {there} {fewest}."
    )


_MOST_WAYS = 3


def _ways(vendor: str, groups: Groups, values: Values) -> str:
    """Describe the medians of the only middleware, in the same domain and through each bridge."""
    metric = values.default_metric
    ways: dict[str, list[int]] = {}
    for group in sorted(groups.groups, key=lambda group: group.series):
        median_ns = values.times_ns[metric]["p50"][group.index]
        if median_ns is not None:
            ways.setdefault(domain_label(groups.series_of(group)), []).append(median_ns)
    spans = {
        way: " to ".join(dict.fromkeys(format_duration(end) for end in (min(medians_ns), max(medians_ns))))
        for way, medians_ns in ways.items()
    }
    what = f"{vendor}: median {METRIC_LABELS[metric].lower()}{_of_survivors(groups.groups, values)}"
    if len(spans) == 1:
        return f"{what} {next(iter(spans.values()))}."
    said = [f"{span} {_IN_WAY.get(way, way)}" for way, span in list(spans.items())[:_MOST_WAYS]]
    return f"{what} {_and(said)}."


def _of_survivors(groups: Iterable[Group], values: Values) -> str:
    """Name the messages that a time is of, where any of these groups lost one or never sent it; empty otherwise."""
    are_whole = all(
        group.received == group.published and not values.plain["unsent"][group.index] for group in groups
    )
    return "" if are_whole else " of the survivors (the messages that came back)"


_IN_WAY = {"same domain": "in the same domain", "different domains": "across domains"}


def _level_remarks(groups: Groups, values: Values, metric: str) -> list[str]:
    """State the lowest and highest median of each data type, with their groups."""
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
        low, high = ((ns, groups.groups[index]) for ns, index in (medians[0], medians[-1]))
        survivors = _of_survivors((low[1], high[1]), values)
        first = f"{data_type_label(data_type)}: median {METRIC_LABELS[metric].lower()}{survivors} {format_duration(low[0])}"
        if low[1] == high[1]:
            remarks.append(f"{first} ({_place(groups, low[1].index, labels)}).")
        else:
            ends = tuple(_place(groups, end.index, labels) for end in (low[1], high[1]))
            remarks.append(f"{first} ({ends[0]}) to {format_duration(high[0])} ({ends[1]}).")
    return remarks


def _place(groups: Groups, index: int, labels: Sequence[str]) -> str:
    data_type = data_type_label(groups.cell_of(groups.groups[index]).data_type)
    return labels[index].removeprefix(data_type).strip()


def _bridge_remarks(costs: pl.DataFrame, vendors: VendorLabels) -> list[str]:
    """State what each vendor and bridge adds to the median latency across domains, on each pair of devices and link."""
    ways: dict[str, list[dict[str, Any]]] = {}
    known = (pl.col("statistic") == "p50") & (pl.col("metric") == "latency")
    told = list(costs.filter(known).iter_rows(named=True))
    places = [_place_of_cost(row) for row in told]
    for row, place in zip(told, places, strict=True):
        where = f", on {place}" if len(set(places)) > 1 else ""
        ways.setdefault(f"{way_label(row, vendors)}{where}", []).append(row)
    return [_bridge_remark(way, rows) for way, rows in ways.items()]


def _place_of_cost(row: Mapping[str, Any]) -> str:
    conditions = condition_of(str(row["setting"]))
    return place_label(row["ping_device"], row["relay_device"], row["connectivity"], conditions)


# DataVerdict of `dds_trace.analyzer.verdicts.compare` on a bridge -> words, in the order of the sentence.
_BRIDGE_VERDICTS = {
    "worse": "clearly slower",
    "better": "clearly faster",
    "same": "the same within 5 %",
    "inconclusive": "no clear difference",
}


def _bridge_remark(way: str, rows: list[dict[str, Any]]) -> str:
    # Where messages were lost, the latency of the rest is biased: the quick ones came back.
    whole = [
        row
        for row in rows
        if row["new_received_ratio"] >= row["base_received_ratio"]
        and row["difference_ns"] is not None
        and math.isfinite(row["difference_ns"])
    ]
    lossy = sum(row["new_received_ratio"] < row["base_received_ratio"] for row in rows)
    left = len(rows) - len(whole) - lossy
    said = [_added_words(whole)] if whole else []
    if lossy:
        said.append(
            f"{combinations(lossy)} lost messages that the same domain did not, and {'is' if lossy == 1 else 'are'} not compared."
        )
    if left:
        said.append(f"{combinations(left)} lost most of the messages in the same domain too.")
    return f"{way}: {' '.join(said)}"


def _added_words(rows: list[dict[str, Any]]) -> str:
    added = sorted(row["difference_ns"] for row in rows)
    if len(rows) == 1:
        said = _BRIDGE_VERDICTS[rows[0]["verdict"]]
        low, high = rows[0]["difference_low_ns"], rows[0]["difference_high_ns"]
        between = (
            ""
            if low is None or high is None
            else f" (95 %{_within(rows[0])}: {format_added_ns(low)} to {format_added_ns(high)})"
        )
        return f"median {format_added_ns(added[0])}{between} against the same domain in the one combination compared; {said}."
    verdicts = Counter(row["verdict"] for row in rows)
    counts = [f"{words} in {verdicts[name]}" for name, words in _BRIDGE_VERDICTS.items() if verdicts[name]]
    counts[0] += f" of {combinations(len(rows))}"
    ends = f"{format_added_ns(added[0])} to {format_added_ns(added[-1])}"
    return f"median {ends} against the same domain; {', '.join(counts)}."


def _within(row: Mapping[str, Any]) -> str:
    return f", {row['basis']}" if row["basis"] == Basis.WITHIN_RUN.value else ""


def way_label(row: Mapping[str, Any], vendors: VendorLabels) -> str:
    """Name the vendor and bridge of a row of `bridge_costs`, as in `Fast DDS, through our built-in bridge`."""
    return f"{vendors.of_pair(row['vendor'], row['relay_vendor'])}, {way_words(row['bridge'])}"


def _deadline_remarks(details: Details, groups: Groups) -> list[str]:
    """State how many messages missed the deadline, of how many it cannot be told, and where most missed it."""
    if details.deadline_ns is None or not details.freshness.height:
        return []
    counts = ("missed", "judged", "unsure")
    by_group = details.freshness.group_by("group").agg(pl.col(*counts).sum()).sort("group")
    missed, judged, unsure = (int(by_group[name].sum()) for name in counts)
    label = _DEADLINE_LABELS.get(details.deadline_metric) or METRIC_LABELS[details.deadline_metric].lower()
    share = f" ({format_ratio(missed / judged)})" if missed else ""
    said = (
        f"Deadline of {format_duration(details.deadline_ns)} for the {label}: "
        f"{format_count(missed)} of {counted(judged, 'message', text=format_count(judged))} missed it{share}"
    )
    if missed and len(by_group) > 1:
        worst = max(by_group.iter_rows(named=True), key=_missed_ratio)
        where = group_labels(groups)[worst["group"]]
        said += f", the largest share in {where} ({format_ratio(_missed_ratio(worst))} of its messages)"
    open_ones = (
        f" Of {counted(unsure, 'more message', text=format_count(unsure))} it cannot be told."
        if unsure
        else ""
    )
    return [f"{said}.{open_ones}"]


_DEADLINE_LABELS = {
    "response": "response (planned send to reply)",
    "outbound": "way out",
    "return": "way back",
}
"""Metric of a deadline -> its label, where it is not that of a figure."""


def _missed_ratio(row: Mapping[str, int]) -> float:
    """Return the share of all messages that surely missed the deadline: of those that cannot be told none."""
    return row["missed"] / max(1, row["judged"] + row["unsure"])


def _unknown_remarks(metric: str) -> list[str]:
    if metric == "latency":
        return []
    what = METRIC_LABELS[metric].lower()
    return [
        f"No relay's trace was found: the latency is unknown, and the {what} below has the time in the relay in it."
    ]


def _losses(values: Values) -> str:
    published = round(sum(count or 0 for count in values.plain["published"]))
    received = sum(count or 0 for count in values.plain["received"])
    unsent = _unsent(values)
    lost = published - received
    if lost == 0:
        return f"Every message {'that left ' if unsent else ''}came back.{unsent}"
    touched = sum(
        (a or 0) > (b or 0) for a, b in zip(values.plain["published"], values.plain["received"], strict=True)
    )
    count = len(values.plain["published"])
    groups = f"{format_count(touched)} of {counted(count, 'group', text=format_count(count))}"
    share = format_ratio(lost / published)
    messages = counted(published, "message", text=format_count(published))
    return f"{format_count(lost)} of {messages} ({share}) did not come back, in {groups}.{unsent}"


def _unsent(values: Values) -> str:
    """Say how many messages were due and never left, behind a sentence; empty if none was."""
    counts = [round(count or 0) for count in values.plain["unsent"]]
    if not any(counts):
        return ""
    of_groups = counted(len(counts), "group", text=format_count(len(counts)))
    said = counted(sum(counts), "more message was", "more messages were", text=format_count(sum(counts)))
    return f" {said} due and never left, in {sum(map(bool, counts))} of {of_groups}; verdicts count them as lost."


def _and(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
