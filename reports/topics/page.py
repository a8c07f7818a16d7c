"""`topics.html`: the health of recordings as one page without scripts, each topic with its strip of time."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from dds_trace.analyzer.recordings.card import RecordingHealth
from dds_trace.analyzer.recordings.topics import TopicReport
from dds_trace.base.printable import printable

from .words import (
    COLUMNS,
    HOW_TO_READ,
    JudgedTopic,
    Row,
    cells,
    clock_words,
    facts_words,
    hole_lines,
    pause_lines,
    seconds_words,
    topic_notes,
    topics_of,
    verdict_words,
)

STRIP_WIDTH = 720
_THINNEST = 1.0


def render(report: TopicReport, judged: Sequence[JudgedTopic] = ()) -> str:
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(_asset("topics", "topics.html.j2")).render(
        policy="default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'",
        style=Markup(_asset("html", "page.css") + _asset("topics", "topics.css")),  # noqa: S704 - our own files
        columns=COLUMNS,
        width=STRIP_WIDTH,
        recordings=[_recording(report, health) for health in report.recordings],
        judged=[(one.outcome.value, one.gate.text, printable(one.topic)) for one in judged],
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
                "cells": cells(row),
                "lines": [*hole_lines(row, holes), *topic_notes(row)],
                "qos": printable(row["qos"]),
                "blocks": _blocks(health, row, holes, strip),
            }
            for row, holes, strip in topics
        ],
        "end": clock_words(health.duration_ns / 1e9),
    }


def _blocks(
    health: RecordingHealth, row: Row, holes: Sequence[Row], strip: Sequence[float]
) -> list[tuple[float, float, str, str]]:
    """Return left edge, width, class and title of what is drawn: the messages, and holes above them."""
    scale = STRIP_WIDTH / max(health.duration_ns / 1e9, 1e-9)
    if not row["missing_from"]:
        part = STRIP_WIDTH / len(strip)
        return [(round(at * part, 1), round(part, 1), "some", "") for at, share in enumerate(strip) if share]
    left = (row["start_ns"] - health.start_ns) / 1e9 * scale
    width = row["duration_ns"] / 1e9 * scale
    drawn = [(round(left, 1), round(width, 1), "there", "")]
    for hole in holes:
        title = f"nothing for {seconds_words(hole['duration_s'])} at {clock_words(hole['start_s'])}"
        kind = "inside" if hole["inside"] else "hole"
        drawn.append(
            (round(hole["start_s"] * scale, 1), round(max(hole["duration_s"] * scale, _THINNEST), 1), kind, title)
        )
    return drawn


def _asset(room: str, name: str) -> str:
    return (files(f"dds_trace.reports.{room}") / "assets" / name).read_text(encoding="utf-8")
