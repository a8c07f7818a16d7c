"""The health of recordings as JSON, Markdown, a page without scripts, and tables of the terminal; every string of a recording is escaped."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from rich.table import Table
from rich.text import Text

from dds_trace.analyzer.recordings.card import RecordingHealth
from dds_trace.analyzer.recordings.topics import TopicReport
from dds_trace.base.files import asset
from dds_trace.base.printable import printable
from dds_trace.base.streams import plain_console
from dds_trace.base.units import clock_words

from ..book.groups import markdown
from .words import (
    COLUMNS,
    HOW_TO_READ,
    JudgedTopic,
    Row,
    cells,
    facts_words,
    pause_lines,
    seconds_words,
    topic_lines,
    topics_of,
    verdict_words,
)

FORMAT_VERSION = 1

_RENAMED = {"topic": "name", "stamps_backwards": "backward_stamps"}
_OF_HOLE = ("start_s", "duration_s", "missing", "inside")


def render_json(report: TopicReport, judged: Sequence[JudgedTopic] = ()) -> str:
    topics = [
        {
            **{_RENAMED.get(name, name): _plain(value) for name, value in row.items()},
            "holes": [{name: hole[name] for name in _OF_HOLE} for hole in holes],
            "strip": [round(share, 4) for share in strip],
        }
        for health in report.recordings
        for row, holes, strip in topics_of(report, health.path)
    ]
    document = {
        "format": FORMAT_VERSION,
        "verdict": report.verdict,
        "recordings": [
            {**asdict(health), "pauses": [{"start_s": start, "duration_s": length} for start, length in health.pauses]}
            for health in report.recordings
        ],
        "topics": topics,
        "gates": [
            {
                "gate": outcome.gate.text,
                "recording": outcome.recording,
                "topic": outcome.topic,
                "outcome": outcome.outcome.value,
            }
            for outcome in judged
        ],
        "sources": [asdict(source) for source in report.sources],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


WIDTH = 80
_LONGEST_NAME = 28
_LEVELS = "·▁▂▃▄▅▆▇█"
_STYLES = {"whole": "green", "holes": "yellow", "damaged": "red"}


def strip_text(strip: Sequence[float], *, is_periodic: bool) -> str:
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
        longest = max((len(row["topic"]) for row in rows), default=0)
        table.add_column(COLUMNS[0], overflow="fold", min_width=min(longest, _LONGEST_NAME))
        for name in COLUMNS[1:]:
            table.add_column(name, justify="right", overflow="fold")
        for row, _, strip in topics:
            table.add_row(*map(Text, cells(row, strip)))
        console.print(table)
        for row, holes, strip in topics:
            if lines := topic_lines(row, holes, health):
                console.print(Text(printable(row["topic"]), style="bold"))
                console.print(Text(f"  {strip_text(strip, is_periodic=row['missing_from'] != '')}"))
                for line in lines:
                    console.print(Text(f"  {line}"))
        console.print()
    for outcome in judged:
        console.print(Text(outcome.line))
    if report.recordings:
        console.print(Text(HOW_TO_READ, style="dim"))


def render_markdown(report: TopicReport, judged: Sequence[JudgedTopic] = ()) -> str:
    lines = ["# Are these recordings whole?", ""]
    for health in report.recordings:
        topics = topics_of(report, health.path)
        rows = [row for row, _, _ in topics]
        lines += [f"## {markdown(health.path)}", "", f"**{markdown(verdict_words(health, rows))}**", ""]
        lines += [f"{markdown(facts_words(health, len(rows)))}.", ""]
        notes = [*pause_lines(health), *health.damages, *health.notes]
        lines += [*(f"- {markdown(line)}" for line in notes), ""] if notes else []
        lines += [f"| {' | '.join(COLUMNS)} | Time |", f"|---|{'---:|' * (len(COLUMNS) - 1)}---|"]
        for row, _, strip in topics:
            shown = strip_text(strip, is_periodic=row["missing_from"] != "").replace(" ", "\u2007")
            lines.append(f"| {' | '.join(map(markdown, cells(row, strip)))} | <code>{shown}</code> |")
        about = [
            f"- {markdown(row['topic'])}: {markdown(line)}"
            for row, holes, _ in topics
            for line in topic_lines(row, holes, health)
        ]
        lines += ["", *about, ""]
    lines += [f"- {markdown(outcome.line)}" for outcome in judged]
    return "\n".join([*lines, "", HOW_TO_READ, ""])


STRIP_WIDTH = 720
_THINNEST = 1.0


def render_page(report: TopicReport, judged: Sequence[JudgedTopic] = ()) -> str:
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(asset(__package__, "topics.html.j2")).render(
        policy="default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'",
        style=Markup(asset("dds_trace.reports.html", "page.css") + asset(__package__, "topics.css")),  # noqa: S704 - our own files
        columns=COLUMNS,
        width=STRIP_WIDTH,
        recordings=[_recording(report, health) for health in report.recordings],
        judged=[(outcome.outcome.value, outcome.gate.text, printable(outcome.topic)) for outcome in judged],
        how_to_read=HOW_TO_READ,
    )


def _recording(report: TopicReport, health: RecordingHealth) -> dict[str, Any]:
    topics = topics_of(report, health.path)
    rows = [row for row, _, _ in topics]
    return {
        "path": printable(health.path),
        "verdict": health.verdict,
        "said": verdict_words(health, rows),
        "facts": facts_words(health, len(rows)),
        "lines": [printable(line) for line in (*pause_lines(health), *health.damages, *health.notes)],
        "topics": [
            {
                "cells": cells(row, strip),
                "lines": topic_lines(row, holes, health),
                "qos": printable(row["qos"]),
                "blocks": strip_blocks(health, row, holes, strip),
            }
            for row, holes, strip in topics
        ],
        "end": clock_words(health.duration_ns / 1e9),
    }


def strip_blocks(
    health: RecordingHealth, row: Row, holes: Sequence[Row], strip: Sequence[float]
) -> list[tuple[float, float, str, str]]:
    scale = STRIP_WIDTH / max(health.duration_ns / 1e9, 1e-9)
    if not row["missing_from"]:
        part = STRIP_WIDTH / len(strip)
        return [(round(at * part, 1), round(part, 1), "some", "") for at, share in enumerate(strip) if share]
    start = (row["start_ns"] - health.start_ns) / 1e9 * scale
    width = row["duration_ns"] / 1e9 * scale
    drawn = [(round(start, 1), round(width, 1), "there", "")]
    for hole in holes:
        title = f"nothing for {seconds_words(hole['duration_s'])} at {clock_words(hole['start_s'])}"
        kind = "inside" if hole["inside"] else "hole"
        drawn.append(
            (round(hole["start_s"] * scale, 1), round(max(hole["duration_s"] * scale, _THINNEST), 1), kind, title)
        )
    return drawn
