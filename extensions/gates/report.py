"""The report of a comparison: the answer, the gates, then the results, worst first."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from operator import or_
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from dds_trace.analyzer.analysis import Analysis
from dds_trace.analyzer.exports.kinds import write_text_file
from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.statistics.power import confidence_at_each
from dds_trace.base.printable import printable
from dds_trace.base.streams import say
from dds_trace.base.units import counted, first_of, format_duration, format_ratio, joined
from dds_trace.reports import blocks
from dds_trace.reports.blocks import (
    MARKDOWN,
    PAGE,
    TERMINAL,
    Block,
    Column,
    Heading,
    Points,
    Row,
    Section,
    Sentence,
    Span,
    Table,
)
from dds_trace.reports.book.groups import time_words
from dds_trace.reports.book.verdicts import VERDICTS, received_words, runs_words
from dds_trace.reports.reporters import load_reporter
from dds_trace.reports.terminal import print_report

from . import words
from .compare import CompareOptions, Comparison, compare
from .comparison_rows import DISTRIBUTION_LEVELS
from .document import comparison_document, render_annotations, render_badge, render_junit
from .gate import Gate, GateOutcome
from .gates import judge_gates, options_for, overall_outcome
from .info import ComparedGroup, ComparisonInfo, comparison_info, mean_change

SIGNATURE = "<!-- dds-trace compare -->"
"""By which CI finds the comment that it updates."""
HOW_TO_READ_STRIPS = (
    "A bar spans the middle half of the messages, its line 1 to 99 of 100, the gap in it is the median; both sides share "
    "the scale below."
)
HOW_TO_READ_STATISTICS = (
    "'New is below base': how often a message of the new side takes less than one of the base; 50 % is no difference. "
    "'Seen from': the smallest change that this result by itself shows in 8 of 10 comparisons."
)

_TONES = {GateOutcome.REGRESSED: "bad", GateOutcome.PASSED: "good"}
_SIGNS = {GateOutcome.PASSED: "✅", GateOutcome.REGRESSED: "❌"}


@dataclass(frozen=True)
class ComparisonReport(blocks.Report):
    info: ComparisonInfo
    comparison: Comparison
    title: str
    shows_all: bool = False
    name = "comparison"
    kicker = "Comparison of latency"

    @property
    def most(self) -> int | None:
        return None if self.shows_all else words.MOST_ROWS

    @property
    def document(self) -> Mapping[str, Any]:
        return comparison_document(self.info, self.comparison)

    @property
    def sections(self) -> Sequence[Section]:
        info = self.info
        parts: list[tuple[str, Iterator[Block]]] = [("answer", self._answer())]
        gates = [Heading("Gates", media=PAGE), *gate_blocks(info.gates, self.most, info.said)]
        parts += [("gates", iter(gates))] if info.gates else []
        parts += [("groups", self._results())] if info.groups else []
        for title, names in (("Only in the base", info.only_base), ("Only in the new side", info.only_new)):
            parts += [("", self._named(title, names))] if names else []
        return [Section([*content], name) for name, content in (*parts, ("", self._notes()))]

    def _answer(self) -> Iterator[Block]:
        info, outcome = self.info, self.info.outcome
        yield Sentence([Span(SIGNATURE, "raw")], media=MARKDOWN)
        yield Heading(self.kicker, 1, media=MARKDOWN)
        yield Heading("The answer", media=PAGE)
        headline, *others = info.answer
        yield Sentence(headline, "headline", media=TERMINAL | PAGE)
        word = "" if outcome is GateOutcome.INCONCLUSIVE else f"{outcome.word.capitalize()}: " if outcome else ""
        sign = f"{_SIGNS.get(outcome, '❔')} {word}" if outcome else ""
        yield Sentence([Span(sign, "raw"), Span(headline, "")], "headline", media=MARKDOWN)
        yield from (Sentence(sentence) for sentence in others)
        if info.seen:
            yield Sentence(info.seen, "seen", media=PAGE if info.gates else PAGE | TERMINAL | MARKDOWN)
        if outcome:
            yield Sentence(outcome.word.capitalize(), f"outcome {outcome.value}", media=PAGE)

    def _results(self) -> Iterator[Block]:
        info, most = self.info, self.most
        yield Heading("Results, worst first", media=PAGE)
        yield Sentence(HOW_TO_READ_STRIPS, "how", media=PAGE)
        yield blocks.Key([("base", "base"), ("new", "new side")], media=PAGE)
        yield result_table(info, most, self._in_markdown)
        others = info.groups[most:] if most else ()
        verdicts = Counter(group.verdict for group in others)
        listed = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
        yield from _more(f"and {counted(len(others), 'result')} more ({listed})", len(others))
        if self.shows_all:
            statistics = [_statistics(info.groups, "Every statistic"), Sentence(HOW_TO_READ_STATISTICS)]
            yield blocks.Fold("Every statistic", statistics, media=MARKDOWN)
        yield from (Sentence(rule, "rule", media=PAGE | MARKDOWN if self.shows_all else PAGE) for rule in info.rules)

    @property
    def _in_markdown(self) -> int:
        groups = len(self.info.groups)
        return groups if self.shows_all else 0 if self.info.gates else min(groups, words.MOST_ROWS)

    def _named(self, title: str, names: Sequence[str]) -> Iterator[Block]:
        yield Heading(title, media=PAGE)
        yield Sentence(f"{title}:", media=TERMINAL | MARKDOWN)
        yield Points(names, media=PAGE)
        shown = names if self.most is None else first_of(names, self.most, "more: --all")
        yield Points(shown, bullet=" ", media=TERMINAL | MARKDOWN)

    def _notes(self) -> Iterator[Block]:
        info, most = self.info, self.most
        reasons = " ".join(gated.result.reason for gated in info.gates)
        notes = [note for note in info.notes if note.partition(": ")[2] not in reasons]
        if notes:
            yield Heading("Differences between the sides", media=PAGE)
            yield Points(notes, bullet="", media=TERMINAL | PAGE)
            yield Points(notes[:most], media=MARKDOWN)
        if info.groups:
            yield Sentence(" ".join(info.rules), "soft", media=TERMINAL)
        if most:
            hidden = {"gate": len(words.gate_rows(info.gates)[most:]), "result": len(info.groups) - self._in_markdown}
            if counts := [counted(count, noun) for noun, count in hidden.items() if count]:
                more = f"Not in a table here: {joined(counts)}; `dds-trace compare` with `--all` or `--report html` has all."
                yield Sentence([Span(more, "raw")], media=MARKDOWN)


def gate_blocks(gates: Sequence[words.Gated], most: int | None, answer: str = "") -> Iterator[Block]:
    notes = [note for note in words.gate_notes(gates) if note not in answer]
    for media, shown in ((TERMINAL | MARKDOWN, most), (PAGE, None)):
        rows = [
            Row([[Span(mark, _TONES.get(outcome, "open"))], *cells], part=cells[-1])
            for outcome, (mark, *cells) in words.gate_rows(gates, shows_all=shown is None)
        ]
        is_found = any(row.cells[3] for row in rows)
        mark, gate, measured, found, where = words.GATE_COLUMNS
        columns = [*map(Column, (mark, gate, measured)), Column(found, media=media if is_found else blocks.Medium(0))]
        columns.append(Column(where, media=MARKDOWN | PAGE))
        yield Table(columns, rows[:shown], label="Table of the gates", look="data cards", gap=2, media=media)
        yield Points(notes[:shown], bullet="", media=media)
        hidden = len(rows[shown:]) + len(notes[shown:]) if shown else 0
        yield from _more(f"and {hidden} more", hidden)


def result_table(info: ComparisonInfo, in_terminal: int | None, in_markdown: int | None) -> Table:
    names = [row["statistic"] for row in info.groups[0].shown()]
    columns = [Column("Result", media=TERMINAL), Column("Result", media=MARKDOWN | PAGE)]
    columns += [Column(f"{info.metric}, base and new", media=PAGE)]
    columns += [Column(f"{info.metric} {words.statistic_words(name)}") for name in names]
    is_changed = any("→" in received_words(group.delivery) for group in info.groups)
    columns += [Column("Received", media=blocks.EVERYWHERE if is_changed else MARKDOWN | PAGE), Column("Verdict")]
    shown = {TERMINAL: in_terminal, MARKDOWN: in_markdown}
    rows = []
    for index, group in enumerate(info.groups):
        others = (medium for medium, most in shown.items() if most is None or index < most)
        rows.append(_row(group, reduce(or_, others, PAGE)))
    if len(info.groups) > 1:
        means = [words.change_words(mean_change(info.groups, name)) for name in names]
        mean = f"Geometric mean of {len(info.groups)} results"
        rows.append(Row(["", "", "", *means, "", ""], part=mean, media=TERMINAL))
    return Table(columns, rows, label="Table of the results", opens="Distributions and every statistic")


def _more(text: str, count: int) -> Iterator[Block]:
    if count:
        yield Sentence(f"{text}: --all", "soft", media=TERMINAL)


def _row(group: ComparedGroup, media: blocks.Medium) -> Row:
    distributions = (row for row in group.distributions if row["metric"] == group.changes[0]["metric"])
    changes = [
        blocks.stack(Span(words.both_words(row), "times"), Span(words.change_with_interval(row), "change"))
        for row in group.shown()
    ]
    verdict = blocks.stack(Span(group.verdict, f"verdict {words.tone_of(group.verdict)}"), Span(group.where, "soft"))
    label = blocks.stack(Span(group.label, ""), Span(printable(group.unlike), "soft"))
    drawn = blocks.Figure(svg=next(map(strip, distributions), ""))
    cells: list[blocks.Words] = [group.message, label, drawn, *changes, received_words(group.delivery), verdict]
    return Row(cells, part=group.setup, details=partial(_details, group), media=media)


def _details(group: ComparedGroup) -> list[Block]:
    curves = [blocks.Figure(svg=curve(row)) for row in group.distributions]
    return [*curves, _statistics([group], f"Every statistic of {group.label}")]


def _statistics(groups: Sequence[ComparedGroup], label: str) -> Table:
    numbers = ("Base", "New", "Change", "Interval", "New is below base")
    columns = [Column("Result", media=MARKDOWN), Column("Time"), *(Column(name, right=True) for name in numbers)]
    columns += [Column("Runs"), Column("Seen from", right=True), Column("Verdict")]
    rows = [
        Row(
            [
                group.label,
                f"{words.metric_words(row['metric'])} {words.statistic_words(row['statistic'])}",
                *(words.side_words(row, side) for side in SIDES),
                words.change_words(row["ratio"]),
                words.interval_words(row),
                "" if row["superiority"] is None else format_ratio(round(row["superiority"], 2)),
                runs_words(row),
                "" if row["smallest_ratio"] is None else words.found_from_words(row["smallest_ratio"]),
                VERDICTS[row["verdict"]],
            ]
        )
        for group in groups
        for row in group.changes
    ]
    return Table(columns, rows, label=label)


SIDES = ("base", "new")
STRIP_WIDTH, CURVE_WIDTH, CURVE_HEIGHT = 250, 330, 190
_MARGIN = 8


class _Scale:
    def __init__(self, row: Mapping[str, Any], left: float, right: float) -> None:
        values = [value for side in SIDES for value in row[f"{side}_ns"] if 0 < value < math.inf]
        self.low_ns, self.high_ns = min(values, default=1.0), max(values, default=1.0)
        self._left, self._right = left, right

    def __call__(self, value_ns: float) -> float:
        if math.isinf(value_ns):
            return self._right
        if self.high_ns <= self.low_ns or value_ns <= 0:
            return self._left if value_ns < self.low_ns else (self._left + self._right) / 2
        share = math.log(value_ns / self.low_ns) / math.log(self.high_ns / self.low_ns)
        return self._left + share * (self._right - self._left)


def _levels(row: Mapping[str, Any], side: str) -> dict[float, float]:
    return dict(zip(DISTRIBUTION_LEVELS, row[f"{side}_ns"], strict=False))


def strip(row: Mapping[str, Any]) -> Markup:
    scale = _Scale(row, _MARGIN, STRIP_WIDTH - _MARGIN)
    parts = []
    for side, y in zip(SIDES, (9, 23), strict=True):
        at = _levels(row, side)
        if not at:
            continue
        ends = at.get(0.01, min(at.values())), at.get(0.99, max(at.values()))
        parts.append(_path(f"{side} range", *((scale(end), y) for end in ends)))
        if 0.25 in at and 0.75 in at:
            parts.append(_path(f"{side} middle", (scale(at[0.25]), y), (scale(at[0.75]), y)))
        if 0.5 in at:
            x = scale(at[0.5])
            parts.append(_path("median", (x, y - 5), (x, y + 5)))
    return _svg("strip", STRIP_WIDTH, 46, [*parts, *_ends(scale, STRIP_WIDTH, 42)], _medians(row))


def curve(row: Mapping[str, Any]) -> Markup:
    left, bottom, top = 42, CURVE_HEIGHT - 24, 18
    scale = _Scale(row, left, CURVE_WIDTH - _MARGIN)

    def height(share: float) -> float:
        return bottom - share * (bottom - top)

    metric = words.metric_words(row["metric"])
    parts = [_text(f"{metric}, messages received within it", left, 12)]
    for share in (0, 0.5, 1):
        parts.append(_path("frame", (left, height(share)), (CURVE_WIDTH - _MARGIN, height(share))))
        parts.append(_text(f"{round(100 * share)} %", left - 4, round(height(share) + 4, 1), anchor="end"))
    for side in SIDES:
        times = _levels(row, side).items()
        points = [(scale(value), height(level)) for level, value in times if math.isfinite(value)]
        if points:
            parts.append(_path(f"{side} line{' dashed' if side == 'base' else ''}", *points))
    parts += _ends(scale, CURVE_WIDTH, CURVE_HEIGHT - 8, left)
    return _svg("curve", CURVE_WIDTH, CURVE_HEIGHT, parts, f"{metric}: {_medians(row)}")


def _medians(row: Mapping[str, Any]) -> str:
    base, new = (time_words(_levels(row, side).get(0.5)) for side in SIDES)
    return f"distributions of both sides, medians {base} and {new}"


def _ends(scale: _Scale, width: float, y: float, left: float = _MARGIN) -> list[Markup]:
    return [
        _text(format_duration(scale.low_ns), left, y),
        _text(format_duration(scale.high_ns), width - _MARGIN, y, anchor="end"),
    ]


def _text(text: str, x: float, y: float, anchor: str = "start") -> Markup:
    return Markup('<text x="{}" y="{}" text-anchor="{}">{}</text>').format(x, y, anchor, text)


def _path(name: str, *points: tuple[float, float]) -> Markup:
    steps = "L".join(f"{round(x, 1):g} {round(y, 1):g}" for x, y in points)
    return Markup('<path class="{}" d="M{}"/>').format(name, steps)


def _svg(name: str, width: int, height: int, parts: Sequence[Markup], label: str) -> Markup:
    return Markup(
        '<svg class="{}" width="{}" height="{}" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>'
    ).format(name, width, height, width, height, label, Markup().join(parts))


def write_report(contents: blocks.Report, kind: str, file: Path | None, text: str = "") -> None:
    if kind == "terminal" and file is None:
        print_report(contents)
        return
    text = text or load_reporter(kind).render(contents)
    if file is not None:
        is_folder = file.is_dir() or not (file.suffix or file.exists())
        file = file / f"{contents.name}.{kind}" if is_folder else file
        print(f"Wrote {write_text_file(file, text)}")
    else:
        method = "write_commands" if kind == "github" else "write"
        getattr(sys.stdout, method, sys.stdout.write)(text)


def write_each(contents: blocks.Report, kinds: Sequence[str], files: Sequence[Path | None]) -> None:
    """Write a report of each kind, and print the answer if all of them are files."""
    for kind, file in zip(kinds, files, strict=True):
        write_report(contents, kind, file)
    if None not in files:
        print_report(contents)


class JudgedSides(NamedTuple):
    comparison: Comparison
    info: ComparisonInfo
    outcome: GateOutcome

    def write(
        self, kind: str = "terminal", file: Path | None = None, title: str = "", *, shows_all: bool = False
    ) -> None:
        contents = ComparisonReport(self.info, self.comparison, title, shows_all=shows_all)
        render = {"junit": render_junit, "github": render_annotations, "badge": render_badge}.get(kind)
        write_report(contents, kind, file, render(self.info) if render else "")

    def end(self, *, strict: bool) -> int:
        return end_with(self.outcome, self.info.gates, strict=strict)


def end_with(outcome: GateOutcome, gates: Sequence[object], *, strict: bool) -> int:
    is_let_pass = outcome is GateOutcome.INCONCLUSIVE and not strict
    if gates or outcome is GateOutcome.NOTHING_TO_COMPARE:
        warning = ", which passes with this warning; --strict fails" if is_let_pass else ""
        say(f"dds-trace: {outcome.word}{warning}")
    return 0 if is_let_pass else outcome.exit_code


def judge_sides(
    base: Path | Analysis,
    new: Path | None,
    gates: Sequence[Gate],
    *,
    looks: int = 1,
    allow_missing: bool = False,
    **options: Any,
) -> JudgedSides:
    before = analyze(base, details=False) if isinstance(base, Path) else base
    after = before if new is None else analyze(new, details=False)
    options_of_look = CompareOptions(confidence=confidence_at_each(looks), **options)
    comparison = compare(before, after, options_for(gates, options_of_look))
    results = judge_gates(comparison, gates, allow_missing=allow_missing)
    for folder, side in ((base, before), (new, after)):
        for finding in side.findings if isinstance(folder, Path) else ():
            if finding.code == "not_applied":
                say(f"{folder}: {finding.where}: {finding.what}")
    if comparison.delivery.is_empty():
        outcome = GateOutcome.NOTHING_TO_COMPARE
    else:
        outcome = overall_outcome(result.outcome for result in results) if results else GateOutcome.PASSED
    info = comparison_info(comparison, results)
    if new is None:
        answer = f"{counted(len(info.groups), 'result')} against limits."
        info = replace(info, answer=words.with_undecided((answer,), info.gates), seen="", groups=(), rules=())
    return JudgedSides(comparison, info, outcome)


def judge_topics(analysis: Analysis, gates: Sequence[Gate]) -> int:
    judged = judge_sides(analysis, None, gates)
    judged.write()
    return judged.end(strict=True)
