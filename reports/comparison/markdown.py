"""A comparison as Markdown, with every string from a trace escaped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dds_trace.base.units import counted

from ..book.groups import markdown
from ..book.verdicts import received_words, runs_words
from .words import (
    GATE_COLUMNS,
    VERDICTS,
    both_words,
    change_with_interval,
    found_from_words,
    gate_cells,
    statistic_cells,
    statistic_words,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from .info import ComparedGroup, ComparisonInfo

MOST_GROUPS = 50
"""Results and gates without `--all`, for a comment of a pull request."""


def render(info: ComparisonInfo, *, shows_all: bool = False) -> str:
    """Return the answer, the outcome of the gates, and a row for each result, worst first."""
    most = None if shows_all else MOST_GROUPS
    lines = ["# Comparison of latency", "", f"**{markdown(info.said)}** {markdown(info.seen)}".rstrip(), ""]
    if info.outcome is not None:
        lines += [f"**{info.outcome.value.capitalize()}**", ""]
        lines += [*_table(GATE_COLUMNS, gate_cells(info.gates[:most]), right=(2, 3)), ""]
        lines += _more(len(info.gates), "gate", shows_all=shows_all)
    shown = info.groups[:most]
    if shown:
        lines += [*_groups(info, shown), *_more(len(info.groups), "result", shows_all=shows_all)]
    if info.notes:
        lines += [*(f"- {markdown(note)}" for note in info.notes), ""]
    for title, names in (("Only in the base", info.only_base), ("Only in the new side", info.only_new)):
        if names:
            lines += [f"{title}:", "", *(f"- {markdown(name)}" for name in names[:most]), ""]
            lines += _more(len(names), "result", shows_all=shows_all)
    if shown:
        lines += [*_statistics(shown), *(f"{markdown(rule)}\n" for rule in info.rules)]
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
    left = 0 if shows_all else count - MOST_GROUPS
    return [f"And {counted(left, noun)} more: `--all`.", ""] if left > 0 else []
