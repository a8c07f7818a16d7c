"""A comparison in 80 columns: the answer, then one row for each result, worst first."""

from __future__ import annotations

import io
from collections import Counter
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.streams import plain_console, without_commands
from dds_trace.base.units import counted

from ..book.verdicts import received_words
from .words import both_words, change_lines, statistic_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .info import ComparedGroup, ComparisonInfo
    from .words import Gated

WIDTH = 80
MOST_GROUPS = 10
COLUMN_WIDTHS = 21, 18, 8, 11
"""Result, each statistic, received, verdict."""

_COLORS = {"no reply came back": "red", "loses more": "red", "slower": "red", "loses less": "green", "faster": "green"}
_OUTCOME_COLORS = {GateOutcome.REGRESSED: "red", GateOutcome.PASSED: "green"}


def render(info: ComparisonInfo, *, shows_all: bool = False) -> str:
    """Return the comparison as plain text of 80 columns, without colours."""
    text = io.StringIO()
    plain_console(file=text, width=WIDTH, color_system=None).print(_report(info, shows_all))
    return without_commands("\n".join(line.rstrip() for line in text.getvalue().splitlines()) + "\n")


def write(info: ComparisonInfo, *, shows_all: bool = False) -> None:
    """Print the comparison to stdout, in colours if stdout is a terminal."""
    console = plain_console()
    console.print(_report(info, shows_all), width=min(console.width, 120) if console.is_terminal else WIDTH)


def _report(info: ComparisonInfo, shows_all: bool) -> RenderableType:
    # Text objects only: rich would interpret [markup] in a str.
    parts: list[RenderableType] = [Text(info.said, style="bold")]
    parts += [Text(info.seen)] if info.seen else []
    parts += [Text(), *_gates(info.gates, shows_all)] if info.gates else [Text()]
    if info.groups:
        shown = info.groups if shows_all else info.groups[:MOST_GROUPS]
        parts += [_table(info, shown), *_rest(info.groups[len(shown) :]), Text()]
    for title, names in (("Only in the base", info.only_base), ("Only in the new side", info.only_new)):
        parts += _named(title, names, shows_all)
    parts += [Text(note) for note in info.notes]
    parts += [Text(" ".join(info.rules), style="dim")] if info.groups else []
    return Group(*parts)


def _table(info: ComparisonInfo, groups: Sequence[ComparedGroup]) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
    label, cell, received, verdict = COLUMN_WIDTHS
    table.add_column(Text(info.metric), width=label)
    for row in groups[0].shown():
        table.add_column(Text(statistic_words(row["statistic"])), width=cell)
    table.add_column("Received", width=received)
    table.add_column("Verdict", width=verdict)
    for group in groups:
        name = Text.assemble(group.label, (f"\n{group.unlike}", "dim") if group.unlike else "")
        table.add_row(
            name,
            *(Text(f"{both_words(row)}\n{change_lines(row, cell)}") for row in group.shown()),
            Text(received_words(group.delivery).replace(" → ", "\n→ ")),
            Text.assemble(
                (group.verdict, _COLORS.get(group.verdict, "")), (f"\n{group.where}", "dim") if group.where else ""
            ),
        )
    return table


def _rest(groups: Sequence[ComparedGroup]) -> list[Text]:
    counts = Counter(group.verdict for group in groups)
    if not counts:
        return []
    listed = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return [Text(f"and {counted(len(groups), 'result')} more ({listed}): --all", style="dim")]


def _gates(gates: Sequence[Gated], shows_all: bool) -> list[RenderableType]:
    failed = [gate for gate in gates if gate.result.outcome is not GateOutcome.PASSED]
    shown = gates if shows_all else failed[:MOST_GROUPS]
    lines = [Text(gate.line, style=_OUTCOME_COLORS.get(gate.result.outcome, "yellow")) for gate in shown]
    if not shows_all:
        hidden, passed = len(failed) - len(shown), len(gates) - len(failed)
        lines += [Text(f"and {hidden} more that did not pass: --all", style="dim")] if hidden else []
        lines += [Text(f"passed: {counted(passed, 'gate')}", style="green")] if passed else []
    return [*lines, Text()]


def _named(title: str, names: Sequence[str], shows_all: bool) -> list[RenderableType]:
    if not names:
        return []
    shown = names if shows_all else names[:MOST_GROUPS]
    more = [Text(f"  and {len(names) - len(shown)} more: --all", style="dim")] if len(shown) < len(names) else []
    return [Text(f"{title}:"), *(Text(f"  {name}") for name in shown), *more, Text()]
