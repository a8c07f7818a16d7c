"""What was lost, by whom, and what to do about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.names import device_pair
from dds_trace.analyzer.verdicts.answers import CaseAnswer
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, Claim, Judgement, Reason, is_replacing
from dds_trace.base.printable import printable
from dds_trace.base.units import by_number, counted, format_rate, format_ratio, format_size, joined, mean_size

from .groups import (
    MOST_NAMED,
    Group,
    Groups,
    VendorLabels,
    data_type_label,
    domain_label,
    format_count,
    group_labels,
    in_domain,
    size_span,
    some_of,
)
from .numbers import Values
from .verdicts import contender_labels, place_of

_FORGED = {
    "forged_or_foreign": "Do not use, as somebody else may have answered",
    "reply_size": "Do not use, as replies had another size",
    "doubtful_replies": "Doubtful",
}
UNREACHED = {"unreached": "Lost on the way to the relay"}


def found_sentence(analysis: Analysis, groups: Groups, words_of: Mapping[str, str] = _FORGED) -> str:
    labels = group_labels(groups)
    sentences = []
    for code, words in words_of.items():
        whats = {
            group: finding.what for finding in analysis.findings if finding.code == code for group in finding.groups
        }
        parts = [f"{labels[group]} ({what.rstrip('.')})" for group, what in whats.items()]
        sentences += [f"{words}: {some_of(parts, 'more in the findings')}."] * bool(parts)
    return " ".join(sentences)


def loss_sentence(groups: Groups, values: Values) -> str:
    counted_groups = [group for group in groups.groups if not replaces(groups, group)]
    planned, lost = _planned_and_lost(counted_groups, values)
    if not lost:
        return ""
    lossy = [group for group in counted_groups if _planned_and_lost([group], values)[1]]
    scope, unsent = _scope(lossy, groups), sum(round(values.plain["unsent"][group.index] or 0) for group in lossy)
    where = f", all of them {scope}" if scope else ""
    ways: Counter[str] = Counter()
    for group in lossy:
        ways[in_domain(domain_label(groups.series_of(group)))] += _planned_and_lost([group], values)[1]
    ((way, most),) = ways.most_common(1)
    if lost * 2 <= most * 3 < lost * 3 and way not in scope:
        where += f", most of them {way}"
    never = f", {format_count(unsent)} of them never sent" if unsent else ""
    return f"{format_ratio(lost / planned)} of the messages were lost ({format_count(lost)} of {format_count(planned)}{never}){where}."


CAUSES = ("udp_buffer_overflow", "fragments_lost", "unrequested_relay")


def cause_sentence(analysis: Analysis, groups: Groups) -> str:
    lost = {group.index: group.published - group.received for group in groups.groups}
    for code in CAUSES:
        seen = [finding for finding in analysis.findings if finding.code == code and any(map(lost.get, finding.groups))]
        if seen:
            there = sum(lost.get(group, 0) for group in {group for finding in seen for group in finding.groups})
            worst = seen[0]
            more = sum(finding.count for finding in seen if finding.subject is worst.subject) - 1
            others = f", as was seen {counted(more, 'more time')}" if more else ""
            action = worst.action.partition(": ")[2] or worst.action
            share, every = format_count(there), format_count(sum(lost.values()))
            share = "losses" if share == every else f"{share} of {every} losses"
            return printable(f"Seen with {share}: {worst.what.rstrip('.')}{others}. {action[0].upper()}{action[1:]}")
    return ""


def replaces(groups: Groups, group: Group) -> bool:
    return is_replacing(groups.cell_of(group).rate_hz, groups.series_of(group).history)


def throughput_sentence(groups: Groups, values: Values) -> str:
    rates = values.plain["transfer_rate_bytes_per_s"]
    fast = [group for group in groups.groups if not groups.cell_of(group).rate_hz and rates[group.index]]
    labels, parts = group_labels(groups), []
    for group in sorted(fast, key=lambda group: -(rates[group.index] or 0)):
        lost = 1 - (values.plain["received_ratio"][group.index] or 0.0)
        share = f" ({format_ratio(lost)} replaced)" if lost > 0 and replaces(groups, group) else ""
        parts.append(f"{labels[group.index]} {mean_size(rates[group.index] or 0)}/s{share}")
    return f"As fast as messages were taken: {some_of(parts, 'more in the table')}." if parts else ""


def _planned_and_lost(groups: Sequence[Group], values: Values) -> tuple[int, int]:
    planned = sum(group.published + round(values.plain["unsent"][group.index] or 0) for group in groups)
    return planned, planned - sum(group.received for group in groups)


def _scope(lossy: Sequence[Group], groups: Groups) -> str:
    sides: tuple[tuple[Callable[[Group], str], str], ...] = (
        (lambda group: groups.series_of(group).vendor_label, "by {}"),
        (lambda group: in_domain(domain_label(groups.series_of(group))), "{}"),
        (lambda group: printable(groups.series_of(group).connectivity), "over {}"),
    )
    ways, messages = ({part(group) for group in lossy} for part in (sides[1][0], lambda group: group.cell))
    same = [group for group in groups.groups if group.cell in messages]
    vendors = {groups.series_of(group).vendor_label for group in same if sides[1][0](group) in ways}
    parts, is_listed = [], False
    for value_of, words in sides if len(vendors) > 1 else sides[1:]:
        values, all_values = ({value_of(group) for group in side} for side in (lossy, same))
        if values != all_values and len(values) <= (1 if is_listed else MOST_NAMED):
            is_listed = is_listed or len(values) > 1
            parts.append(words.format(joined(sorted(values)).replace(" and through ", " and ")))
    cells = [groups.cell_of(group) for group in lossy]
    if len({cell.data_type for cell in cells}) == 1:
        sizes = sorted({cell.payload_bytes for cell in cells})
        measured = sorted({cell.payload_bytes for cell in groups.cells if cell.data_type == cells[0].data_type})
        span = size_span(sizes, measured)
        if sizes != measured:
            parts.append(f"at {len(sizes)} of {len(measured)} sizes" if span.count(",") >= MOST_NAMED else span)
    return ", ".join(parts)


MACHINE = frozenset({"cpu_saturated", "stood_still", "suspend"})


def avoid_sentence(
    answers: Sequence[CaseAnswer], vendors: VendorLabels, cures: Mapping[int, str], busy: Collection[int] = ()
) -> str:
    lossy = [(row, where) for row, where in _advised(answers, vendors) if row.group not in cures]
    parts = []
    for is_busy, condition in ((False, ""), (True, " on a machine as busy as this one was")):
        same = [pair for pair in lossy if (pair[0].group in busy) is is_busy]
        subjects = [row.subject for row, _ in same]
        order = sorted(same, key=lambda pair: same.index(pair) != subjects.index(pair[0].subject))
        words = some_of([f"{where} ({format_ratio(row.value)} lost)" for row, where in order], "more in the table")
        parts += [f"Do not use{condition}, because of losses: {words}."] * bool(same)
    return " ".join(parts)


def cure_sentence(groups: Groups, cures: Mapping[int, str]) -> str:
    counted_groups = [group for group in groups.groups if not replaces(groups, group)]
    lost = {group.index: group.published - group.received for group in counted_groups}
    unplanned = (group.index for group in counted_groups if "outage=" not in groups.series_of(group).setting)
    cured = [group for group in unplanned if lost[group] and group in cures]
    if not cured:
        return ""
    there, total = sum(lost[group] for group in cured), sum(lost.values())
    share = "All" if there == total else f"{format_count(there)} of {format_count(total)}"
    largest = max((cures[group] for group in cured), key=by_number)
    return f"{share} losses are in results with a known cure; try: {printable(largest)}."


def few_lost_sentence(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> str:
    few = [
        f"{where} ({format_count(row.lost or 0)} of {format_count(row.messages or 0)})"
        for row, where in _lossy(answers, vendors)
        if row.reason == Reason.FEW_LOST.value
    ]
    return f"Too few losses or runs for a verdict: {some_of(few, 'more in the table')}." if few else ""


def _advised(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> list[tuple[Judgement, str]]:
    return [(row, where) for row, where in _lossy(answers, vendors) if row.verdict == DO_NOT_USE]


def _lossy(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> list[tuple[Judgement, str]]:
    """Name setup, message, rate and link; not what all results share, nor the domains."""
    labels = contender_labels(answers, vendors)
    types, places = {answer.data_type for answer in answers}, {place_of(answer) for answer in answers}
    has_devices = len({(answer.ping_device, answer.relay_device) for answer in answers}) > 1
    lossy = []
    for answer in answers:
        devices = "" if has_devices else f"{device_pair(answer.ping_device, answer.relay_device)}, "
        kind = f"{data_type_label(answer.data_type)} " if len(types) > 1 else ""
        place = f", {place_of(answer).removeprefix(devices)}" if len(places) > 1 else ""
        where = f"{kind}{format_size(answer.payload_bytes)} at {format_rate(answer.rate_hz)}{place}"
        lossy += [(row, f"{labels[row.subject]} with {where}") for row in answer.of_claim(Claim.LOSSY)]
    return sorted(lossy, key=lambda one: -(one[0].value or 0.0))
