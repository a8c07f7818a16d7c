"""A comparison in 80 columns: the answer, then one row for each result, worst first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.streams import print_screen, screen_text
from dds_trace.base.units import counted

from ..book.groups import format_ratio
from .info import ComparedGroup, ComparisonInfo, mean_change
from .words import (
    GATE_COLUMNS,
    MOST_ROWS,
    Gated,
    both_words,
    change_words,
    gate_notes,
    gate_rows,
    statistic_words,
    tone_of,
)

COLUMNS, COLUMN_WIDTHS = 80, (23, 17, 9, 18)
"""Message, times, each change, verdict."""
JUDGED = ("worse", "better", "same")

NOT_PROVEN = "In parentheses: no proven change. Intervals: --report md."

_COLORS = {"bad": "red", "good": "green"}
_OUTCOME_COLORS = {GateOutcome.REGRESSED: "red", GateOutcome.PASSED: "green"}


def render(info: ComparisonInfo, *, shows_all: bool = False) -> str:
    return screen_text(_report(info, shows_all))


def write(info: ComparisonInfo, *, shows_all: bool = False) -> None:
    print_screen(_report(info, shows_all))


def _report(info: ComparisonInfo, shows_all: bool) -> RenderableType:
    # Text objects only: rich would interpret [markup] in a str.
    parts: list[RenderableType] = [Text(info.said, style="bold")]
    parts += [Text(info.seen)] if info.seen and not info.gates else []
    parts += [Text(), *_gates(info.gates, shows_all)] if info.gates else [Text()]
    if info.groups:
        shown = info.groups if shows_all else info.groups[:MOST_ROWS]
        parts += [*_tables(info, shown), *_rest(info.groups[len(shown) :]), Text()]
    for title, names in (("Only in the base", info.only_base), ("Only in the new side", info.only_new)):
        parts += _named(title, names, shows_all)
    parts += [Text(note) for note in info.notes]
    parts += [Text(" ".join([NOT_PROVEN, *info.rules]), style="dim")] if info.groups else []
    return Group(*parts)


def _tables(info: ComparisonInfo, groups: Sequence[ComparedGroup]) -> list[RenderableType]:
    statistics = [row["statistic"] for row in groups[0].shown()]
    names = [statistic_words(name) for name in statistics]
    titles = (info.metric, names[0], "change", *names[1:], "verdict")
    parts: list[RenderableType] = [_rows([[Text(title, style="dim") for title in titles]])]
    for setup in dict.fromkeys(group.setup for group in groups):
        parts += [Text(setup, style="bold")] if setup else []
        parts.append(_rows([[Text(group.message), *_cells(group)] for group in groups if group.setup == setup]))
    if len(info.groups) > 1:
        means = [Text(_change(mean_change(info.groups, name)), style="bold") for name in statistics]
        total = [Text("Geometric mean", style="bold"), Text(f"of {len(info.groups)} results"), *means, Text()]
        parts.append(_rows([total]))
    return parts


def _rows(rows: Sequence[Sequence[Text]]) -> Table:
    message, times, change, verdict = COLUMN_WIDTHS
    return _grid(rows, (message, times, *[change] * (len(rows[0]) - 3), verdict), right=change)


def _grid(rows: Sequence[Sequence[Text]], widths: Sequence[int], *, gap: int = 1, right: int = 0) -> Table:
    table = Table.grid(padding=(0, gap, 0, 0))
    for width in widths:
        table.add_column(width=width, justify="right" if width == right else "left")
    for row in rows:
        table.add_row(*row)
    return table


def _cells(group: ComparedGroup) -> list[Text]:
    rows = group.shown()
    changes = [_change(row["ratio"], is_judged=row["verdict"] in JUDGED) for row in rows]
    verdict = Text(group.verdict, style=_COLORS.get(tone_of(group.verdict), ""))
    if group.verdict.startswith("loses"):
        verdict.append(f" {format_ratio(abs(group.delivery['difference'] or 0.0))}")
    elif group.where and len(f"{group.verdict}, {group.where}") <= COLUMN_WIDTHS[3]:
        verdict.append(f", {group.where}", style="dim")
    return [Text(both_words(rows[0])), *map(Text, changes), verdict]


def _change(ratio: float | None, *, is_judged: bool = True) -> str:
    words = change_words(ratio).replace(" times", "x")
    return words if is_judged or ratio is None else f"({words})"


def _rest(groups: Sequence[ComparedGroup]) -> list[Text]:
    counts = Counter(group.verdict for group in groups)
    if not counts:
        return []
    listed = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return [Text(f"and {counted(len(groups), 'result')} more ({listed}): --all", style="dim")]


def _gates(gates: Sequence[Gated], shows_all: bool) -> list[RenderableType]:
    rows, notes = gate_rows(gates, shows_all=shows_all), gate_notes(gates)
    most = None if shows_all else MOST_ROWS
    parts: list[RenderableType] = []
    titles = GATE_COLUMNS[0], *(title.lower() for title in GATE_COLUMNS[1:4])
    widths = [
        max(len(cells[column]) for cells in (titles, *(cells for _, cells in rows[:most]))) for column in range(4)
    ]
    widths[1] = min(widths[1], COLUMNS - sum(widths) + widths[1] - 2 * 3)  # a long gate has several lines
    parts.append(_grid([[Text(title, style="dim") for title in titles]], widths, gap=2))
    previous = ""
    for outcome, (mark, *cells, where) in rows[:most]:
        parts += [Text(where, style="bold")] if where != previous else []
        previous = where
        colored = Text(mark, style=_OUTCOME_COLORS.get(outcome, "yellow"))
        parts.append(_grid([[colored, *map(Text, cells)]], widths, gap=2))
    hidden = len(rows[most:]) + len(notes[most:]) if most else 0
    more = [Text(f"and {hidden} more: --all", style="dim")] if hidden else []
    return [*parts, *map(Text, notes[:most]), *more, Text()]


def _named(title: str, names: Sequence[str], shows_all: bool) -> list[RenderableType]:
    if not names:
        return []
    shown = names if shows_all else names[:MOST_ROWS]
    more = [Text(f"  and {len(names) - len(shown)} more: --all", style="dim")] if len(shown) < len(names) else []
    return [Text(f"{title}:"), *(Text(f"  {name}") for name in shown), *more, Text()]
