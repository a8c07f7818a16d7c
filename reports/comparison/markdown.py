"""A comparison as Markdown, with every string from a trace escaped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.units import counted

from ..book.groups import joined, markdown
from ..book.verdicts import VERDICTS, received_words, runs_words
from .info import ComparedGroup, ComparisonInfo
from .words import (
    GATE_COLUMNS,
    MOST_ROWS,
    both_words,
    change_with_interval,
    found_from_words,
    gate_notes,
    gate_rows,
    statistic_cells,
    statistic_words,
)

_MARKS = {
    GateOutcome.PASSED: "✅",
    GateOutcome.REGRESSED: "❌",
    GateOutcome.INCONCLUSIVE: "❔",
    GateOutcome.NOTHING_TO_COMPARE: "❔",
}

SIGNATURE = "<!-- dds-trace compare -->"
"""By which CI finds the comment that it updates."""


def render(info: ComparisonInfo, *, shows_all: bool = False) -> str:
    most = None if shows_all else MOST_ROWS
    mark = "" if info.outcome is None else f"{_MARKS[info.outcome]} {info.outcome.value.capitalize()}: "
    lines = [SIGNATURE, "", "# Comparison of latency", "", f"**{mark}{markdown(info.said)}**", ""]
    lines += [markdown(info.seen), ""] if info.seen and not info.gates else []
    hidden: Counter[str] = Counter()
    if info.gates:
        rows, notes = gate_rows(info.gates, shows_all=shows_all), gate_notes(info.gates)
        lines += [*_table(GATE_COLUMNS, [cells for _, cells in rows[:most]], right=(2, 3)), ""]
        lines += [*(f"- {markdown(note)}" for note in notes[:most]), ""] if notes else []
        hidden["gate"] = len(rows) - len(rows[:most])
    shown = info.groups if shows_all else () if info.gates else info.groups[:most]
    hidden["result"] = len(info.groups) - len(shown)
    lines += _groups(info, shown) if shown else []
    lines += _statistics(shown) if shows_all and shown else []
    lines += [*(f"- {markdown(note)}" for note in info.notes[:most]), ""] if info.notes else []
    for title, names in (("Only in the base", info.only_base), ("Only in the new side", info.only_new)):
        if names:
            lines += [f"{title}:", "", *(f"- {markdown(name)}" for name in names[:most]), ""]
            hidden["result"] += len(names) - len(names[:most])
    lines += [f"{markdown(rule)}\n" for rule in info.rules] if shows_all and shown else []
    more = [counted(count, noun) for noun, count in hidden.items() if count]
    lines += [f"And {joined(more)} more: `dds-trace compare` with `--all` or `--report html`.", ""] if more else []
    return "\n".join(lines)


def _groups(info: ComparisonInfo, groups: Sequence[ComparedGroup]) -> list[str]:
    labels = [statistic_words(row["statistic"]).capitalize() for row in groups[0].shown()]
    has_unlike = any(group.unlike for group in groups)
    names = (info.metric, *labels, "Received", "Verdict", *(["Environment"] if has_unlike else []))
    rows = (
        (
            group.label,
            *(f"{both_words(row)}, {change_with_interval(row)}" for row in group.shown()),
            received_words(group.delivery),
            f"{group.verdict}: {group.where}" if group.where else group.verdict,
            *([group.unlike or "same"] if has_unlike else []),
        )
        for group in groups
    )
    return [*_table(names, rows), ""]


def _statistics(groups: Sequence[ComparedGroup]) -> list[str]:
    names = (
        *("Result", "Time", "Base", "New", "Change", "Interval"),
        *("New is below base", "Runs", "Found from", "Verdict"),
    )
    rows = (
        (
            group.label,
            *statistic_cells(row),
            "" if row["superiority"] is None else f"{row['superiority']:.0%}",
            runs_words(row),
            "" if row["smallest_ratio"] is None else found_from_words(row["smallest_ratio"]),
            VERDICTS[row["verdict"]],
        )
        for group in groups
        for row in group.changes
    )
    return [
        "<details><summary>Every statistic</summary>",
        "",
        *_table(names, rows, right=(2, 3, 4, 5, 6, 8)),
        "",
        "'New is below base': how often a message of the new side takes less than one of the base; 50% is no difference.",
        "'Found from': the change that this result by itself would have shown with a probability of 80%.",
        "",
        "</details>",
        "",
    ]


def _table(names: Sequence[str], rows: Iterable[Sequence[Any]], right: Sequence[int] = ()) -> list[str]:
    ruler = "|".join("---:" if column in right else "---" for column in range(len(names)))
    return [
        f"| {' | '.join(map(markdown, names))} |",
        f"|{ruler}|",
        *(f"| {' | '.join(map(markdown, row))} |" for row in rows),
    ]
