"""Findings by kind, for every report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.model.finding import Finding, Subject
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import counted

from ..blocks import PAGE, Block, Fold, Points, Sentence, Span
from .groups import Groups, group_labels
from .numbers import Values

SEVERITIES = {"error": "error", "warning": "warning", "info": "note"}

_SPELLED = {"cpu": "CPU", "udp": "UDP"}
_TITLES = {
    "waits_in_reader": "Messages wait for the program that reads them",
    "few_samples": "Too few messages for a percentile",
    "not_applied": "Requested and not applied",
}
"""Where the words of the code are not enough."""

_MOST_NAMED = 3


@dataclass(frozen=True, slots=True)
class OneFinding:
    where: str
    what: str
    action: str
    worst_first: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class FindingKind:
    """Of one severity and code; `count` includes those not listed."""

    severity: str
    code: str
    title: str
    count: int
    listed: tuple[OneFinding, ...]

    @property
    def severity_word(self) -> str:
        return SEVERITIES[self.severity]

    @property
    def heading(self) -> str:
        return self.title if self.count == 1 else f"{self.title} ({self.count})"

    @property
    def common_action(self) -> str:
        actions = {observation.action for observation in self.listed}
        return self.listed[0].action if len(actions) == 1 else ""


def worst_first(values: Values) -> tuple[int, ...]:
    received, times = values.plain["received_ratio"], values.times_ns[values.default_metric]["p50"]
    return tuple(
        sorted(
            range(len(received)),
            key=lambda group: (1.0 if received[group] is None else received[group], -(times[group] or 0)),
        )
    )


def findings_info(analysis: Analysis, groups: Groups, values: Values) -> tuple[FindingKind, ...]:
    rank = {group: index for index, group in enumerate(worst_first(values))}
    labels = group_labels(groups)
    kinds: dict[tuple[str, str], list[Finding]] = {}
    for finding in analysis.findings:
        kinds.setdefault((finding.severity.value, finding.code), []).append(finding)
    return tuple(
        FindingKind(
            severity,
            code,
            _title(code),
            sum(finding.count for finding in same),
            tuple(_one(finding, labels, rank) for finding in same),
        )
        for (severity, code), same in kinds.items()
    )


def severity_counts(kinds: Sequence[FindingKind]) -> tuple[tuple[str, str], ...]:
    counts = Counter(kind.severity for kind in kinds)
    return tuple(
        (severity, counted(counts[severity], word)) for severity, word in SEVERITIES.items() if counts[severity]
    )


_TONES = {"error": "bad", "warning": "open", "info": "info"}
MOST_LINKED = 40


def finding_block(kind: FindingKind, labels: Mapping[int, str]) -> Fold:
    first = kind.listed[0]
    severity = Span(kind.severity_word, f"strong severity {_TONES[kind.severity]}")
    summary = [severity, Span(f" {kind.heading}: "), Span(f"{first.where}: {first.what}", "")]
    parts: list[Block] = [Sentence(first.action, "soft")]
    if len(kind.listed) > 1:
        items = []
        for finding in kind.listed:
            action = [] if kind.common_action else [Span(f" {finding.action}", "soft")]
            items.append([Span(f"{finding.where}:"), Span(f" {finding.what}", ""), *action])
        parts.append(Points(items))
    for finding in kind.listed:
        shown = finding.worst_first[:MOST_LINKED]
        links = [part for group in shown for part in (Span("; ", ""), Span(labels[group], "", group))][1:]
        hidden = len(finding.worst_first) - len(shown)
        links += [Span(f"; and {hidden} more", "")] if hidden else []
        parts += [Sentence(links, "groups", media=PAGE)] if links else []
    return Fold(summary, parts, name=f"{kind.severity}-{kind.code}", tone=kind.severity)


def _one(finding: Finding, labels: Mapping[int, str], rank: Mapping[int, int]) -> OneFinding:
    is_of_recording = finding.subject is Subject.RECORDING
    named = () if is_of_recording else tuple(labels[group] for group in finding.groups)
    if len(named) == len(labels) > 1:
        where = f"all {len(named)} results"
    elif len(named) > _MOST_NAMED:
        where = f"{len(named)} results, such as {named[0]}"
    else:
        where = "; ".join(named) or finding.where
    where, what, action = (printable(text, MAX_FINDING_CHARACTERS) for text in (where, finding.what, finding.action))
    return OneFinding(where, what, action, tuple(sorted(finding.groups, key=rank.__getitem__)))


def _title(code: str) -> str:
    if code in _TITLES:
        return _TITLES[code]
    first, *words = (_SPELLED.get(word, word) for word in printable(code).split("_"))
    return " ".join([first[:1].upper() + first[1:], *words])
