"""The answer in at most `MOST_LINES` lines of 80 columns: proven facts, a picture of bars, thresholds."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence

from rich.text import Text

from dds_trace.analyzer.verdicts.answers import CaseAnswer
from dds_trace.base.units import counted, format_duration, format_rate, format_size

from .book.answer import PointKind
from .book.book import Book
from .book.findings import severity_counts
from .book.headline import COMPARED, Fastest, bridge_facts
from .book.outcomes import outcome_of, shown_case
from .book.verdicts import contender_labels

WIDTH = 80
MOST_LINES = 18
"""Lines of the answer; with the lines of the written files it is a screen of 20."""
MOST_SETUPS = 4
INLINE_BAR, BAR = 5, 30
"""Cells of the longest bar in a line of all setups, and in a line of its own."""

LOSSES = (PointKind.FORGED, PointKind.LOSS, PointKind.AVOID)
FIRST = (PointKind.RECOVERY, *LOSSES, PointKind.CURE)

PASS, FAIL, OPEN = ("✓", "green"), ("✗", "red"), ("·", "dim")


def brief_lines(book: Book) -> list[Text]:
    answer = book.answer
    measured = next((fact.value for fact in book.overview.facts if fact.label == "Messages"), "")
    noun = "message" if measured.startswith("1 ") else "messages"
    title = book.overview.title + (f": {measured.replace(' in ', f' {noun} in ', 1)}" if measured else "")
    parts = [_wrapped(title, "", "bold")]
    vendors = book.groups.vendors
    parts += [
        _marked(FAIL if kind in LOSSES else OPEN, sentence) for kind, sentence in answer.sentences if kind in FIRST
    ]
    thresholds = _thresholds(book)
    parts += [thresholds] if thresholds else []
    if PointKind.FASTEST in answer.kinds:
        parts += _winners(book.fastest, contender_labels(book.analysis.details.answers, vendors))
    for kind, sentence in answer.sentences:
        if kind is PointKind.BRIDGE:
            facts = [
                words.replace(" as long", "") for words in bridge_facts(book.analysis.details.bridge_costs, vendors)
            ]
            parts.append([*_wrapped(COMPARED, "", "bold"), *(line for fact in facts for line in _marked(PASS, fact))])
        elif kind not in (*FIRST, PointKind.FASTEST):
            parts.append(_marked(OPEN, sentence))
    return _fitted(parts, "" if book.shows_all else _more(book))


def _fitted(parts: Sequence[list[Text]], more: str) -> list[Text]:
    lines: list[Text] = []
    remaining = 0
    for part in parts:
        if remaining or len(lines) + len(part) > MOST_LINES - 1:
            remaining += 1
        else:
            lines += part
    remainder = f"{counted(remaining, 'more fact')}, {more}" if remaining else more
    return [*lines, Text(f"--all shows {remainder}", style="dim")] if more else lines


def _more(book: Book) -> str:
    findings = [words for _, words in severity_counts(book.findings)]
    return ", ".join([*findings, f"tables of {counted(len(book.groups.groups), 'result')}"])


def _wrapped(text: str, indent: str, style: str = "") -> list[Text]:
    lines = textwrap.wrap(text, WIDTH - 1, subsequent_indent=indent, break_on_hyphens=False)
    return [Text(line, style=style) for line in lines]


def _marked(mark: tuple[str, str], text: str) -> list[Text]:
    first, *others = _wrapped(f"{mark[0]} {text}", "  ")
    first.stylize(mark[1], 0, 1)
    return [first, *others]


def _winners(kinds: Sequence[Fastest], labels: Mapping[str, str]) -> Iterator[list[Text]]:
    is_drawn = False
    for kind in kinds:
        lines = _wrapped(kind.heading, "", "bold")
        for span, words, is_decided in kind.lines:
            lines += _marked(PASS if is_decided else OPEN, f"{span}: {words}")
        if not is_drawn and (bars := _bars(kind.cases, labels, place=kind.place if " on " in kind.heading else "")):
            is_drawn, lines = True, [*lines, *bars]
        yield lines


def _bars(cases: Sequence[CaseAnswer], labels: Mapping[str, str], place: str) -> list[Text]:
    if not any(outcome_of(case).is_decided for case in cases):
        return []
    case = shown_case(cases)
    times = sorted(
        (setup.p50_ns, labels[setup.name])
        for setup in case.contenders
        if setup.p50_ns is not None and math.isfinite(setup.p50_ns)
    )[:MOST_SETUPS]
    if len(times) < 2:
        return []
    size, longest_ns = format_size(case.payload_bytes), max((ns for ns, _ in times), default=1)
    line = "  " + "   ".join(f"{name} {_bar(ns, longest_ns, INLINE_BAR)} {format_duration(ns)}" for ns, name in times)
    where = ", ".join(filter(None, (place, f"{size} at {format_rate(case.rate_hz)}")))
    for end in (where, size):
        if len(f"{line}   {end}") < WIDTH and not place:
            return [Text(f"{line}   {end}")]
    width = max(len(name) for _, name in times)
    bar = max(1, min(BAR, WIDTH - width - len("        999.9 ms")))
    rows = [f"  {name:<{width}}  {_bar(ns, longest_ns, bar):<{bar}}  {format_duration(ns)}" for ns, name in times]
    return [Text(f"  median at {where}:", style="dim"), *(Text(row) for row in rows)]


def _bar(value: float, longest: float, cells: int) -> str:
    return "▇" * max(1, round(cells * value / longest))


def _thresholds(book: Book) -> list[Text]:
    sizes = book.sizes
    if sizes is None or not sizes.deadline:
        return []
    lines = _wrapped(f"{sizes.deadline[:1].upper()}{sizes.deadline[1:]}", "", "bold")
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
        lines += _marked(FAIL if worst.outcome == "fail" else OPEN, f"{choice}{on}: {worst.why}")
    return [*lines, *(_marked(PASS, ", ".join(passed)) if passed else [])]
