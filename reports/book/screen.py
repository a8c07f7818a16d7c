"""The answer on one screen of a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.base.units import counted, format_duration, format_rate, format_size

from ..blocks import FAIL, MARKS, OPEN, PASS, TERMINAL, Bars, Block, Fitted, Section, Sentence, Span
from .answer import PointKind
from .contents import Contents
from .fastest import Fastest
from .findings import severity_counts
from .groups import time_words
from .headline import COMPARED, bridge_facts
from .numbers import ALL_MESSAGES, TYPICAL_RUN
from .sizes import SizeTable
from .verdicts import contender_labels

MOST_LINES = 20
"""With the lines of the written files it is a screen of 24."""
MOST_SETUPS = 4
MOST_ADVICE = 6
"""Setups of a recommendation without `--all`."""

NONE = Span("")
LOSSES = (PointKind.FORGED, PointKind.LOSS, PointKind.AVOID)
DOUBTS = (PointKind.CLIENT_FLOOR, PointKind.DOUBT)
FIRST = (PointKind.RECOVERY, PointKind.INTERFERENCE, *LOSSES, PointKind.CAUSE, PointKind.CURE)


def screen(book: Contents) -> list[Section]:
    advice = book.advice_blocks(None if book.shows_all else MOST_ADVICE)
    return [Section(advice or [_brief(book)], media=TERMINAL)]


def _brief(book: Contents) -> Fitted:
    answer = book.answer
    title = ": ".join(filter(None, (book.title, book.overview.messages)))
    parts: list[Sequence[Block]] = [[Sentence(title, "strong", NONE)]]
    parts += [
        [Sentence(f"{kind.heading}: {kind.listed[0].what} {kind.listed[0].action}", mark=FAIL)]
        for kind in book.findings
        if kind.severity == Severity.ERROR.value
    ]
    vendors = book.groups.vendors
    parts += [
        [Sentence(sentence, mark=FAIL if kind in LOSSES and answer.outcome == "lossy" else OPEN)]
        for kind, sentence in answer.sentences
        if kind in FIRST
    ]
    doubts = len(parts)
    parts += [[Sentence(sentence, mark=OPEN) for kind, sentence in answer.sentences if kind in DOUBTS]]
    parts += _thresholds(book.sizes)
    if PointKind.FASTEST in answer.kinds:
        parts += _winners(book.fastest, contender_labels(book.analysis.details.answers, vendors))
    for kind, sentence in answer.sentences:
        if kind is PointKind.BRIDGE:
            facts = bridge_facts(book.analysis.details.bridge_costs, vendors)
            sentences = [Sentence(fact.replace(" as long", ""), mark=PASS) for fact in facts]
            parts.append([Sentence(COMPARED, "strong", NONE), *sentences])
        elif kind not in (*FIRST, *DOUBTS, PointKind.FASTEST):
            parts.append([Sentence(sentence, mark=OPEN)])
    if PointKind.FASTEST not in answer.kinds:
        labels = contender_labels(book.analysis.details.answers, vendors)
        parts += [[bars] for kind in book.fastest[:1] for bars in _bars(kind, labels, kind.place)]
    findings = [words for severity, words in severity_counts(book.findings) if severity != Severity.ERROR.value]
    results = len(book.groups.groups)
    more = ", ".join([*findings, *([f"tables of {counted(results, 'result')}"] if results else [])])
    return Fitted(parts, doubts, MOST_LINES, "" if book.shows_all else more)


def _winners(kinds: Sequence[Fastest], labels: Mapping[str, str]) -> Iterator[list[Block]]:
    is_drawn = False
    for kind in kinds:
        part: list[Block] = [Sentence(kind.heading, "strong", NONE)]
        part += [Sentence(f"{span}: {words}", mark=PASS if decided else OPEN) for span, words, decided in kind.lines]
        bars = [] if is_drawn else _bars(kind, labels, place=kind.place if " on " in kind.heading else "")
        is_drawn = is_drawn or bool(bars)
        yield [*part, *bars]


def _bars(kind: Fastest, labels: Mapping[str, str], place: str) -> list[Bars]:
    case = kind.shown
    times = sorted(
        (setup.p50_ns, labels[setup.name], "" if setup.p99_ns is None else f", p99 {time_words(setup.p99_ns)}")
        for setup in case.contenders
        if setup.p50_ns is not None and math.isfinite(setup.p50_ns)
    )[:MOST_SETUPS]
    if len(times) < 2:
        return []
    size = format_size(case.payload_bytes)
    where = ", ".join(filter(None, (place, f"{size} at {format_rate(case.rate_hz)}")))
    rows = [(name, ns, format_duration(ns), p99) for ns, name, p99 in times]
    of = TYPICAL_RUN if case.fewest_runs >= MIN_RUNS else ALL_MESSAGES
    return [Bars(rows, f"median of {of}, {where}", () if place else (f"median, {where}", where, size))]


def _thresholds(sizes: SizeTable | None) -> list[list[Block]]:
    if sizes is None or not sizes.deadline:
        return []
    lines: list[Block] = [Sentence(f"{sizes.deadline[:1].upper()}{sizes.deadline[1:]}", "strong", NONE)]
    order, passed = ["fail", "not known", "pass"], []
    for index, choice in enumerate(sizes.choices):
        judged = [
            (result, rows.place) for rows in sizes.places if rows.thresholds and (result := rows.thresholds[index])
        ]
        worst, site = min(judged, key=lambda pair: order.index(pair[0].outcome), default=(None, ""))
        if worst is None or worst.outcome == "pass":
            passed += [choice] if worst else []
            continue
        on = f" on {site}" if len(sizes.places) > 1 else ""
        lines.append(Sentence(f"{choice}{on}: {worst.why}", mark=MARKS.get(worst.outcome, OPEN)))
    return [[*lines, *([Sentence(f"{', '.join(passed)}: every message in time", mark=PASS)] if passed else [])]]
