"""Terminal report: the answer and one line per group, with a sparkline, in 80 columns."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from dds_trace.analyzer.statistics.intervals import MIN_EPISODES, MIN_RUNS
from dds_trace.base.printable import printable
from dds_trace.base.units import MISSING, format_duration, format_rate, format_size

from .book.groups import METRIC_LABELS, format_ratio
from .book.sizes import HOW_TO_READ

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .book.book import Book
    from .book.groups import Groups
    from .book.numbers import Intervals, Values
    from .book.sizes import SizeCell, Threshold

WIDTH = 80
_FACT_COLUMNS = 20
"""Columns of a fact's name."""
SPARK_CELLS = 12
_BLOCKS = " ▁▂▃▄▅▆▇█"
_COLORS = {"error": "red", "warning": "yellow", "info": "blue"}
_COLUMNS = (
    ("Size", 7),
    ("Rate", 7),
    ("Runs", 4),
    ("Recv", 9),
    ("p50", 7),
    ("p99", 7),
    ("Epi.", 4),
    ("max", 7),
)
_NOTES = (
    f"Runs: with a *, what is said holds within one run; it takes {MIN_RUNS} to tell more. Epi.: the episodes that "
    f"p99 rests on; with fewer than {MIN_EPISODES} nothing is known of how late it may be."
)


def render(book: Book) -> str:
    """Return the report as plain text of 80 columns, without colours."""
    text = io.StringIO()
    Console(file=text, width=WIDTH, color_system=None, legacy_windows=False).print(_report(book))
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()) + "\n"


def write(book: Book, folder: Path) -> None:  # noqa: ARG001 - every reporter has this door
    """Print the report to stdout, in colours if stdout is a terminal."""
    console = Console(legacy_windows=False)
    console.print(_report(book), width=min(console.width, 120) if console.is_terminal else WIDTH)


def _report(book: Book) -> RenderableType:
    # Text objects only: rich would interpret [markup] in a str, and strings from traces must stay literal.
    overview, answer = book.overview, book.answer
    return Group(
        Text(f"Latency report: {overview.title}", style="bold"),
        Text(),
        *_advice(book),
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
        *_tables(book),
    )


def render_advice(book: Book) -> str:
    """Return the recommendation alone, as plain text of 80 columns; empty without one."""
    text = io.StringIO()
    Console(file=text, width=WIDTH, color_system=None, legacy_windows=False).print(Group(*_advice(book)))
    return (
        "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip("\n") + "\n"
        if book.advice
        else ""
    )


_FIT_COLORS = {"meets": "green", "misses": "red"}


def _advice(book: Book) -> list[RenderableType]:
    """List the settings for the job, best first, each with its numbers and what these rest on."""
    advice = book.advice
    if advice is None:
        return []
    grid = Table.grid(padding=(0, 1, 0, 0))
    grid.add_column(no_wrap=True)
    for setting, fit, numbers in advice.brief_rows:
        grid.add_row(Text(fit, style=_FIT_COLORS.get(fit, "")), Text(setting))
        grid.add_row(Text(), Text(numbers, style="dim"))
    return [Text(advice.said, style="bold"), Text(f"Asked: {advice.asked}"), grid, Text()]


MOST_CHOICES = 4
"""Choices side by side in 80 columns; more of them follow in a table of their own."""

_OUTCOME_COLORS = {"pass": "green", "fail": "red"}


def _sizes(book: Book) -> list[RenderableType]:
    """Make a table of sizes by choice for each place; best times in bold, losses in red."""
    sizes = book.sizes
    if sizes is None:
        return []
    parts: list[RenderableType] = []
    for place in sizes.places:
        parts.append(Text(f"Latency {sizes.rates}, median / p99, on {place.place}", style="bold"))
        for start in range(0, len(sizes.choices), MOST_CHOICES):
            shown = slice(start, start + MOST_CHOICES)
            table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
            table.add_column("Size", width=15)
            for choice in sizes.choices[shown]:
                table.add_column(Text(choice), width=15)
            if place.thresholds:
                table.add_row(Text(sizes.deadline), *map(_threshold, place.thresholds[shown]))
            for row in place.rows:
                table.add_row(Text(row.size), *map(_size_cell, row.cells[shown]))
            parts += [table, Text()]
    return [*parts, Text(HOW_TO_READ, style="dim"), Text()]


def _threshold(one: Threshold | None) -> Text:
    if one is None:
        return Text()
    return Text.assemble(
        (one.outcome, _OUTCOME_COLORS.get(one.outcome, "")), f": {one.why}" if one.why else ""
    )


def _size_cell(cell: SizeCell | None) -> Text:
    if cell is None:
        return Text()
    times = Text(" / ").join(
        Text(text, style="bold" if leads else "")
        for text, leads in ((cell.p50, cell.leads_p50), (cell.p99, cell.leads_p99))
    )
    return Text.assemble(times, (f"\n{cell.lost}", "red")) if cell.lost else times


def _list(items: Sequence[str]) -> Table:
    grid = Table.grid(padding=(0, 1, 0, 0))
    for item in items:
        grid.add_row(Text("-"), Text(item))
    return grid


def _findings(book: Book) -> list[RenderableType]:
    """List each kind with its first finding; the HTML and JSON reports hold the others."""
    lines: list[RenderableType] = []
    for kind in book.findings:
        first = kind.listed[0]
        heading = (f"{kind.severity_word} ", f"bold {_COLORS[kind.severity]}"), (f"{kind.heading}: ", "bold")
        lines.append(Text.assemble(*heading, f"{first.where}: {first.what}"))
        lines.append(Padding(Text(first.action, style="dim"), (0, 0, 0, 2)))
    return [*lines, Text()] if lines else []


@dataclass(frozen=True, slots=True)
class _Shown:
    """Numbers of the tables, and the common ends of all sparklines in ns."""

    groups: Groups
    values: Values
    intervals: Intervals
    metric: str
    curves: Sequence[tuple[int, ...]]
    ends_ns: tuple[int, int]


def _tables(book: Book) -> list[RenderableType]:
    """Make one table per series, then the legend of the sparklines."""
    groups, values = book.groups, book.values
    curves = book.curves.values_ns[values.default_metric]
    known = [value for curve in curves for value in curve if value > 0]
    shown = _Shown(
        groups,
        values,
        book.intervals,
        values.default_metric,
        curves,
        (min(known, default=1), max(known, default=1)),
    )
    tables: list[RenderableType] = []
    for place, label in enumerate(groups.labels):
        tables += [Text(label, style="bold"), _table(shown, place), Text()]
    if known:
        low, high = (format_duration(end) for end in shown.ends_ns)
        note = f"{METRIC_LABELS[shown.metric]} of the survivors, the messages that came back. Each sparkline spans {low} to {high} (log scale): where the messages lie."
        tables += [Text(note, style="dim"), Text(_NOTES, style="dim")]
    return tables


def _table(shown: _Shown, series: int) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
    table.add_column("Data", width=7, no_wrap=True, overflow="ellipsis")
    for name, width in _COLUMNS:
        table.add_column(name, width=width, justify="right", no_wrap=True, overflow="ellipsis")
    table.add_column("Distribution", width=SPARK_CELLS, no_wrap=True)
    times = shown.values.times_ns[shown.metric]
    groups = (group for group in shown.groups.groups if group.series == series)
    for group in sorted(groups, key=lambda group: group.cell):
        cell = shown.groups.cell_of(group)
        table.add_row(
            Text(printable(cell.data_type)),
            format_size(cell.payload_bytes),
            format_rate(cell.rate_hz),
            _runs(shown, group.index),
            format_ratio(shown.values.plain["received_ratio"][group.index]),
            *(format_duration(times[name][group.index]) for name in ("p50", "p99")),
            _episodes(shown, group.index),
            format_duration(times["max"][group.index]),
            Text(_sparkline(shown.curves[group.index], shown.ends_ns)),
        )
    return table


def _runs(shown: _Shown, group: int) -> str:
    """Return the runs of a group, with a star where they are too few to tell more than of one run."""
    runs = shown.values.plain["runs"][group]
    return MISSING if runs is None else f"{runs:.0f}" + ("*" if runs < MIN_RUNS else "")


def _episodes(shown: _Shown, group: int) -> str:
    """Return the episodes that the p99 of a group rests on; a dash where no message lies beyond it."""
    episodes = shown.intervals.tail_episodes(shown.metric, "p99", group)
    return MISSING if episodes is None else str(episodes)


def _sparkline(curve: Sequence[int], ends: tuple[int, int]) -> str:
    """Draw where the values of a curve lie between the ends, on a log axis; a dash without a curve.

    The height of a bar counts levels of the curve. Levels are denser in the tail, so that rare late messages stay
    visible.
    """
    positive = [value for value in curve if value > 0]
    if not positive:
        return MISSING
    low, high = math.log(ends[0]), math.log(ends[1])
    counts = [0] * SPARK_CELLS
    for value in positive:
        share = (math.log(value) - low) / (high - low) if high > low else 0.5
        counts[min(SPARK_CELLS - 1, int(share * SPARK_CELLS))] += 1
    most = max(counts)
    return "".join(_BLOCKS[math.ceil(count / most * (len(_BLOCKS) - 1))] for count in counts)
