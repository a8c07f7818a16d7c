"""A comparison as Markdown for a pull request or a job summary.

Strings from traces are escaped for the format, and control characters are spelled out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dds_trace.base.units import counted

from ..book.groups import METRIC_LABELS, STATISTIC_LABELS, markdown
from ..changes import received_words, runs_words
from .words import (
    VERDICTS,
    both_words,
    change_with_interval,
    change_words,
    gate_interval_words,
    interval_words,
    measured_words,
    survivors_words,
    why_words,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from .info import ComparedGroup, ComparisonInfo, Gated

MOST_GROUPS = 50
"""Groups and gates that are shown unless all are asked for: a comment of a pull request holds no more."""


def render(info: ComparisonInfo, *, shows_all: bool = False) -> str:
    """Return the comparison as Markdown: the answer, the outcome of the gates, a row for each group, worst first."""
    lines = ["# Comparison of latency", "", f"**{markdown(info.said)}** {markdown(info.seen)}".rstrip(), ""]
    if info.outcome is not None:
        lines += [f"**{info.outcome.value.capitalize()}**", ""]
        lines += _gates(info.gates if shows_all else info.gates[:MOST_GROUPS])
        lines += _more(len(info.gates), "gate", shows_all=shows_all)
    shown = info.groups if shows_all else info.groups[:MOST_GROUPS]
    if shown:
        lines += [*_groups(info, shown), *_more(len(info.groups), "group", shows_all=shows_all)]
    if info.notes:
        lines += [*(f"- {markdown(note)}" for note in info.notes), ""]
    for title, names in (("Only in the base", info.only_base), ("Only in the new side", info.only_new)):
        if names:
            listed = names if shows_all else names[:MOST_GROUPS]
            lines += [f"{title}:", "", *(f"- {markdown(name)}" for name in listed), ""]
            lines += _more(len(names), "group", shows_all=shows_all)
    if shown:
        lines += [*_statistics(shown), *(f"{markdown(rule)}\n" for rule in info.rules)]
    return "\n".join(lines)


def _gates(gates: Sequence[Gated]) -> list[str]:
    rows = (
        (
            one.result.gate.text,
            one.where,
            measured_words(one.result, one.result.measured),
            gate_interval_words(one.result),
            one.result.outcome.value,
            why_words(one.result),
        )
        for one in gates
    )
    return [*_table(("gate", "group", "measured", "interval", "outcome", "why"), rows, right=(2, 3)), ""]


def _groups(info: ComparisonInfo, groups: Sequence[ComparedGroup]) -> list[str]:
    labels = [STATISTIC_LABELS.get(row["statistic"], row["statistic"]) for row in groups[0].shown()]
    knows_environments = any(group.unlike for group in groups)
    names = (info.metric, *labels, "came back", "verdict", *(["environment"] if knows_environments else []))
    rows = (
        (
            group.label,
            *(f"{both_words(row)}, {change_with_interval(row)}" for row in group.shown()),
            received_words(group.delivery),
            f"{group.verdict}: {group.where}" if group.where else group.verdict,
            *([group.unlike or "same"] if knows_environments else []),
        )
        for group in groups
    )
    return [*_table(names, rows), ""]


def _statistics(groups: Sequence[ComparedGroup]) -> list[str]:
    """Put every metric and statistic behind a line that opens."""
    names = (
        "group",
        "time",
        "base",
        "new",
        "change",
        "interval",
        "new is below base",
        "runs",
        "found from",
        "verdict",
    )
    rows = (
        (
            group.label,
            f"{METRIC_LABELS.get(row['metric'], row['metric'])} {STATISTIC_LABELS.get(row['statistic'], row['statistic'])}",
            survivors_words(row, "base"),
            survivors_words(row, "new"),
            change_words(row["ratio"]),
            interval_words(row),
            "" if row["superiority"] is None else f"{row['superiority']:.0%}",
            runs_words(row),
            "" if row["smallest_ratio"] is None else change_words(row["smallest_ratio"]),
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
        "'Found from': the change that this group alone would have shown with a probability of 80%.",
        "",
        "</details>",
        "",
    ]


def _table(names: Sequence[str], rows: Iterable[Sequence[Any]], right: Sequence[int] = ()) -> list[str]:
    ruler = "|".join("---:" if place in right else "---" for place in range(len(names)))
    return [
        f"| {' | '.join(map(markdown, names))} |",
        f"|{ruler}|",
        *(f"| {' | '.join(map(markdown, row))} |" for row in rows),
    ]


def _more(count: int, noun: str, *, shows_all: bool) -> list[str]:
    left = 0 if shows_all else count - MOST_GROUPS
    return [f"And {counted(left, noun)} more: `--all`.", ""] if left > 0 else []
