"""A comparison as Markdown, with every string from a trace escaped."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from dds_trace.analyzer.verdicts.gate import GateOutcome
from dds_trace.base.printable import printable
from dds_trace.base.units import counted

from ..book.groups import markdown
from ..book.verdicts import received_words, runs_words
from .info import ComparedGroup, ComparisonInfo
from .words import (
    GATE_COLUMNS,
    VERDICTS,
    both_words,
    change_with_interval,
    change_words,
    found_from_words,
    gate_cells,
    metric_words,
    statistic_cells,
    statistic_words,
    time_words,
)

MOST_GROUPS = 50
"""Results and gates without `--all`, for a comment of a pull request."""
MOST_DRAWN = 5
MOST_LABEL = 40

_MARKS = {
    GateOutcome.PASSED: "✅",
    GateOutcome.REGRESSED: "❌",
    GateOutcome.INCONCLUSIVE: "❔",
    GateOutcome.NOTHING_TO_COMPARE: "❔",
}


def render(info: ComparisonInfo, *, shows_all: bool = False) -> str:
    most = None if shows_all else MOST_GROUPS
    mark = "" if info.outcome is None else f"{_MARKS[info.outcome]} {info.outcome.value.capitalize()}: "
    shown = info.groups[:most]
    lines = ["# Comparison of latency", "", f"**{mark}{markdown(info.said)}**", ""]
    lines += [markdown(info.seen), ""] if info.seen else []
    lines += [*_counted_gates(info), *_picture(info.groups)]
    folded: list[str] = []
    if info.gates:
        folded += [*_table(GATE_COLUMNS, gate_cells(info.gates[:most]), right=(2, 3)), ""]
        folded += _more(len(info.gates), "gate", shows_all=shows_all)
    if shown:
        folded += [*_groups(info, shown), *_more(len(info.groups), "result", shows_all=shows_all), *_statistics(shown)]
    folded += [*(f"- {markdown(note)}" for note in info.notes), ""] if info.notes else []
    for title, names in (("Only in the base", info.only_base), ("Only in the new side", info.only_new)):
        if names:
            folded += [f"{title}:", "", *(f"- {markdown(name)}" for name in names[:most]), ""]
            folded += _more(len(names), "result", shows_all=shows_all)
    folded += [f"{markdown(rule)}\n" for rule in info.rules] if shown else []
    if not folded:
        return "\n".join(lines)
    counts = ((len(info.groups), "result"), (len(info.gates), "gate"), (len(info.notes), "note"))
    title = ", ".join(counted(count, noun) for count, noun in counts if count) or "what only one side has"
    return "\n".join([*lines, f"<details><summary>{title}</summary>", "", *folded, "</details>", ""])


def _counted_gates(info: ComparisonInfo) -> list[str]:
    counts = Counter(gated.result.outcome.value for gated in info.gates)
    words = ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
    return [f"{counted(len(info.gates), 'gate')}: {words}.", ""] if words else []


def _picture(groups: Sequence[ComparedGroup]) -> list[str]:
    rows = [(group, group.shown()[0]) for group in groups[:MOST_DRAWN] if group.changes]
    rows = [
        (group, row) for group, row in rows if all(math.isfinite(row[end] or math.inf) for end in ("base_ns", "new_ns"))
    ]
    if not rows:
        return []
    width = min(max(len(group.label) for group, _ in rows), MOST_LABEL)
    lines = []
    for group, row in rows:
        longest = max(row["base_ns"], row["new_ns"], 1)
        base, new = (
            f"{'▇' * max(1, round(20 * row[end] / longest))} {time_words(row[end])}" for end in ("base_ns", "new_ns")
        )
        lines += [
            f"{printable(group.label, width):{width}}  base {base}",
            f"{'':{width}}  new  {new}  {change_words(row['ratio'])}, {group.verdict}",
        ]
    statistic = statistic_words(rows[0][1]["statistic"])
    remaining = f" of {len(groups)}, worst first" if len(groups) > len(rows) else ""
    title = f"{metric_words(rows[0][1]['metric'])}, {statistic}: {counted(len(rows), 'result')}{remaining}"
    return ["<pre>", title, *(markdown(line) for line in lines), "</pre>", ""]


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
            found_from_words(row["smallest_ratio"]),
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


def _more(count: int, noun: str, *, shows_all: bool) -> list[str]:
    remaining = 0 if shows_all else count - MOST_GROUPS
    return [f"And {counted(remaining, noun)} more: `--all`.", ""] if remaining > 0 else []
