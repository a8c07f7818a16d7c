"""The health of recordings as tables of the terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from dds_trace.analyzer.recordings.topics import TopicReport
from dds_trace.base.printable import printable
from dds_trace.base.streams import plain_console

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

WIDTH = 80
_LEVELS = "·▁▂▃▄▅▆▇█"
_STYLES = {"whole": "green", "holes": "yellow", "damaged": "red"}


def strip_text(strip: Sequence[float], *, is_periodic: bool) -> str:
    """Return a strip of time: full where no message is missing, a dot where all are."""
    if not is_periodic:
        return "".join("▪" if share else " " for share in strip)
    return "".join(_LEVELS[int(share * 8)] for share in strip)


def print_topics(report: TopicReport, judged: Sequence[JudgedTopic] = ()) -> None:
    console = plain_console(width=None if sys.stdout.isatty() else WIDTH)
    for health in report.recordings:
        topics = topics_of(report, health.path)
        rows = [row for row, _, _ in topics]
        console.print(Text(printable(health.path), style="bold"), soft_wrap=True)
        console.print(Text(verdict_words(health, rows), style=_STYLES[health.verdict]))
        console.print(Text(facts_words(health, len(rows))))
        for line in (*pause_lines(health), *health.damages):
            console.print(Text(f"- {printable(line)}"))
        table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
        table.add_column(COLUMNS[0], overflow="fold")
        for name in COLUMNS[1:]:
            table.add_column(name, justify="right", overflow="fold")
        for row in rows:
            table.add_row(*map(Text, cells(row)))
        console.print(table)
        for row, holes, strip in topics:
            lines = [*hole_lines(row, holes), *topic_notes(row)]
            if lines:
                console.print(Text(printable(row["topic"]), style="bold"))
                console.print(Text(f"  {strip_text(strip, is_periodic=row['missing_from'] != '')}"))
                for line in lines:
                    console.print(Text(f"  {line}"))
        console.print()
    for outcome in judged:
        console.print(Text(f"{outcome.outcome.value}: {outcome.gate.text}, {printable(outcome.topic)}"))
    if report.recordings:
        console.print(Text(HOW_TO_READ, style="dim"))
