"""Terminal report: the answer and one line per result, with a sparkline, in 80 columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from dds_trace.analyzer.model.finding import Severity
from dds_trace.analyzer.statistics.intervals import MIN_RUNS, messages_to_end
from dds_trace.analyzer.verdicts.answers import CaseAnswer
from dds_trace.base.printable import printable
from dds_trace.base.streams import SCREEN_WIDTH, print_screen, screen_text
from dds_trace.base.units import MISSING, counted, format_duration, format_rate, format_size

from .book.answer import PointKind
from .book.book import Book
from .book.findings import severity_counts
from .book.groups import METRIC_LABELS, format_ratio
from .book.headline import COMPARED, Fastest, bridge_facts
from .book.outcomes import outcome_of, shown_case
from .book.sizes import HOW_TO_READ, SizeCell, Threshold
from .book.verdicts import contender_labels

MOST_LINES = 18
"""Lines of the answer; with the lines of the written files it is a screen of 20."""
MOST_SETUPS = 4
INLINE_BAR, BAR = 5, 30
"""Cells of the longest bar in a line of all setups, and in a line of its own."""

LOSSES = (PointKind.FORGED, PointKind.LOSS, PointKind.AVOID)
FIRST = (PointKind.RECOVERY, PointKind.INTERFERENCE, *LOSSES, PointKind.CURE)

PASS, FAIL, OPEN = ("✓", "green"), ("✗", "red"), ("·", "dim")


def brief_lines(book: Book) -> list[Text]:
    answer = book.answer
    measured = next((fact.value for fact in book.overview.facts if fact.label == "Messages"), "")
    noun = "message" if measured.startswith("1 ") else "messages"
    title = book.overview.title + (f": {measured.replace(' in ', f' {noun} in ', 1)}" if measured else "")
    parts = [_wrapped(title, "", "bold")]
    parts += [
        _marked(FAIL, f"{kind.heading}: {kind.listed[0].what} {kind.listed[0].action}")
        for kind in book.findings
        if kind.severity == Severity.ERROR.value
    ]
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
    findings = [words for severity, words in severity_counts(book.findings) if severity != Severity.ERROR.value]
    return ", ".join([*findings, f"tables of {counted(len(book.groups.groups), 'result')}"])


def _wrapped(text: str, indent: str, style: str = "") -> list[Text]:
    lines = textwrap.wrap(text, SCREEN_WIDTH - 1, subsequent_indent=indent, break_on_hyphens=False)
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
        if len(f"{line}   {end}") < SCREEN_WIDTH and not place:
            return [Text(f"{line}   {end}")]
    width = max(len(name) for _, name in times)
    bar = max(1, min(BAR, SCREEN_WIDTH - width - len("        999.9 ms")))
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


_FACT_COLUMNS = 20
SPARK_CELLS = 12
_BLOCKS = " ▁▂▃▄▅▆▇█"
_COLORS = {"error": "red", "warning": "yellow", "info": "blue"}
_COLUMNS = (*(("Size", 7), ("Rate", 7), ("Runs", 4), ("Recv", 9)), *(("p50", 7), ("p99", 7), ("Bur.", 4), ("max", 7)))
_NOTES = (
    f"Runs: with a *, numbers hold within one run; a verdict needs {MIN_RUNS}. Bur.: the bursts that p99 rests on; "
    f"one or two runs give it an upper bound from {messages_to_end(0.99)} messages on."
)


def render(book: Book) -> str:
    return screen_text(_report(book))


def render_brief(book: Book) -> str:
    return screen_text(_brief(book))


def write(book: Book, folder: Path) -> None:  # noqa: ARG001 - every reporter has this signature
    print_screen(_report(book) if book.shows_all else _brief(book))


def _brief(book: Book) -> RenderableType:
    return Group(*(_advice(book) or brief_lines(book)))


def _report(book: Book) -> RenderableType:
    # Text objects only: rich would interpret [markup] in a str.
    overview, answer = book.overview, book.answer
    return Group(
        Text(f"Latency report: {overview.title}", style="bold"),
        Text(),
        Text(answer.headline, style="bold"),
        _list(answer.points),
        Text(),
        *_sizes(book),
        *(Text.assemble((f"{fact.label:<{_FACT_COLUMNS}}", "dim"), fact.value) for fact in overview.facts),
        Text(),
        _list(answer.remarks),
        *((Text(answer.rule, style="dim"),) if answer.rule else ()),
        Text(),
        *_findings(book),
        *_topics(book),
        *_tables(book),
        _brief(book),
    )


_FIT_MARKS = {"meets": PASS, "misses": FAIL}
_MOST_ADVICE = 6
"""Setups of a recommendation without `--all`."""


def _advice(book: Book) -> list[RenderableType]:
    advice = book.advice
    if advice is None:
        return []
    rows = advice.brief_rows if book.shows_all else advice.brief_rows[:_MOST_ADVICE]
    grid = Table.grid(padding=(0, 1, 0, 0))
    for number, (setting, fit, numbers) in enumerate(rows, 1):
        mark, color = _FIT_MARKS.get(fit, OPEN)
        grid.add_row(f"{number:2}.", Text(mark, style=color), Text.assemble(f"{setting}: {fit}; ", (numbers, "dim")))
    parts: list[RenderableType] = [Text(f"Job: {advice.job}"), Text(advice.sentence, style="bold"), grid]
    remaining = len(advice.rows) - len(rows)
    parts += [Text(f"and {counted(remaining, 'more setup')}: --all", style="dim")] if remaining else []
    parts += [Text(advice.missing)] if advice.missing else []
    for device, command in advice.commands:
        lines = textwrap.wrap(command, SCREEN_WIDTH - 6, break_on_hyphens=False, break_long_words=False)
        parts += [Text(f"  on {device}:", style="dim"), Text(" \\\n      ".join(["    " + lines[0], *lines[1:]]))]
    return parts


MOST_CHOICES = 3
"""Setups side by side in 80 columns."""

_OUTCOME_COLORS = {"pass": "green", "fail": "red"}


def _sizes(book: Book) -> list[RenderableType]:
    sizes = book.sizes
    if sizes is None:
        return []
    parts: list[RenderableType] = []
    for site in sizes.places:
        parts.append(Text(f"{sizes.caption}, on {site.place}", style="bold"))
        for start in range(0, len(sizes.choices), MOST_CHOICES):
            shown = slice(start, start + MOST_CHOICES)
            table = _new_table()
            table.add_column("Size", width=15)
            for choice in sizes.choices[shown]:
                table.add_column(Text(choice), width=20)
            if site.thresholds:
                table.add_row(Text(sizes.deadline), *map(_threshold, site.thresholds[shown]))
            for row in site.rows:
                table.add_row(Text(row.size), *map(_size_cell, row.cells[shown]))
            parts += [table, Text()]
    return [*parts, Text(HOW_TO_READ, style="dim"), Text()]


def _new_table() -> Table:
    return Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")


def _threshold(threshold: Threshold | None) -> Text:
    if threshold is None:
        return Text()
    why = threshold.text.removeprefix(threshold.outcome)
    return Text.assemble((threshold.outcome, _OUTCOME_COLORS.get(threshold.outcome, "")), why)


def _size_cell(cell: SizeCell | None) -> Text:
    if cell is None:
        return Text()
    times = Text(" / ").join(Text(text, style="bold" if leads else "") for text, leads in cell.times)
    return Text.assemble(times, (f"\n{cell.lost}", "red")) if cell.lost else times


def _list(items: Sequence[str]) -> Table:
    grid = Table.grid(padding=(0, 1, 0, 0))
    for item in items:
        grid.add_row(Text("-"), Text(item))
    return grid


def _findings(book: Book) -> list[RenderableType]:
    lines: list[RenderableType] = []
    for kind in book.findings:
        first = kind.listed[0]
        heading = (f"{kind.severity_word} ", f"bold {_COLORS[kind.severity]}"), (f"{kind.heading}: ", "bold")
        lines.append(Text.assemble(*heading, f"{first.where}: {first.what}"))
        lines.append(Padding(Text(first.action, style="dim"), (0, 0, 0, 2)))
    return [*lines, Text()] if lines else []


def _topics(book: Book) -> list[RenderableType]:
    parts: list[RenderableType] = []
    for topics in book.topic_tables:
        table = _new_table()
        for name in topics.columns:
            table.add_column(name, overflow="fold")
        for row in topics.rows:
            table.add_row(*map(Text, row))
        parts += [Text(topics.title, style="bold"), table, Text(topics.how, style="dim"), Text()]
    return parts


def _tables(book: Book) -> list[RenderableType]:
    metric = book.values.default_metric
    values = [value for curve in book.curves.values_ns[metric] for value in curve if value > 0]
    ends_ns = (min(values, default=1), max(values, default=1))
    title = f"{METRIC_LABELS[metric]} of all messages that were received"
    tables: list[RenderableType] = [Text(title, style="bold"), Text()] if values else []
    for series, label in enumerate(book.groups.labels):
        tables += [Text(label, style="bold"), _table(book, series, ends_ns), Text()]
    if values:
        low, high = map(format_duration, ends_ns)
        note = f"Each sparkline spans {low} to {high} (log scale)."
        tables += [Text(note, style="dim"), Text(_NOTES, style="dim")]
    return tables


def _table(book: Book, series: int, ends_ns: tuple[int, int]) -> Table:
    table = _new_table()
    table.add_column("Data", width=7, no_wrap=True, overflow="ellipsis")
    for name, width in _COLUMNS:
        table.add_column(name, width=width, justify="right", no_wrap=True, overflow="ellipsis")
    table.add_column("Distribution", width=SPARK_CELLS, no_wrap=True)
    values, metric = book.values, book.values.default_metric
    times = values.times_ns[metric]
    for group in book.groups.in_order:
        if group.series != series:
            continue
        cell, index = book.groups.cell_of(group), group.index
        bursts = book.intervals.tail_episodes(metric, "p99", index)
        table.add_row(
            Text(printable(cell.data_type)),
            format_size(cell.payload_bytes),
            format_rate(cell.rate_hz),
            _runs(values.plain["runs"][index]),
            format_ratio(values.plain["received_ratio"][index]),
            *(format_duration(times[name][index]) for name in ("p50", "p99")),
            MISSING if bursts is None else str(bursts),
            format_duration(times["max"][index]),
            Text(_sparkline(book.curves.values_ns[metric][index], ends_ns)),
        )
    return table


def _runs(runs: float | None) -> str:
    return MISSING if runs is None else f"{runs:.0f}" + ("*" if runs < MIN_RUNS else "")


def _sparkline(curve: Sequence[int], ends: tuple[int, int]) -> str:
    positive = [value for value in curve if value > 0]
    if not positive:
        return MISSING
    low, high = map(math.log, ends)
    counts = [0] * SPARK_CELLS
    for value in positive:
        share = (math.log(value) - low) / (high - low) if high > low else 0.5
        counts[min(SPARK_CELLS - 1, int(share * SPARK_CELLS))] += 1
    most = max(counts)
    return "".join(_BLOCKS[math.ceil(count / most * (len(_BLOCKS) - 1))] for count in counts)
