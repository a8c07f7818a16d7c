"""The health of recordings as Markdown, with every string of a recording escaped."""

from __future__ import annotations

from collections.abc import Sequence

from dds_trace.analyzer.recordings.topics import TopicReport

from ..book.groups import markdown
from .terminal import strip_text
from .words import (
    COLUMNS,
    HOW_TO_READ,
    JudgedTopic,
    cells,
    facts_words,
    hole_lines,
    pause_lines,
    topic_notes,
    topics_of,
    verdict_words,
)


def render(report: TopicReport, judged: Sequence[JudgedTopic] = ()) -> str:
    lines = ["# Are these recordings whole?", ""]
    for health in report.recordings:
        topics = topics_of(report, health.path)
        rows = [row for row, _, _ in topics]
        lines += [f"## {markdown(health.path)}", "", f"**{markdown(verdict_words(health, rows))}**", ""]
        lines += [f"{markdown(facts_words(health, len(rows)))}.", ""]
        said = [*pause_lines(health), *health.damages, *health.notes]
        lines += [*(f"- {markdown(line)}" for line in said), ""] if said else []
        lines += [f"| {' | '.join(COLUMNS)} | Time |", f"|---|{'---:|' * (len(COLUMNS) - 1)}---|"]
        for row, _, strip in topics:
            shown = strip_text(strip, is_periodic=row["missing_from"] != "").replace(" ", "\u2007")
            lines.append(f"| {' | '.join(map(markdown, cells(row)))} | <code>{shown}</code> |")
        about = [
            f"- {markdown(row['topic'])}: {markdown(line)}"
            for row, holes, _ in topics
            for line in (*hole_lines(row, holes), *topic_notes(row))
        ]
        lines += ["", *about, ""]
    lines += [f"- {markdown(f'{one.outcome.value}: {one.gate.text}, {one.topic}')}" for one in judged]
    return "\n".join([*lines, "", HOW_TO_READ, ""])
