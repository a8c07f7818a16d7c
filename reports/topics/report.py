"""The report of the health of recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from markupsafe import Markup

from dds_trace.analyzer.recordings.card import RecordingHealth
from dds_trace.analyzer.recordings.topics import TopicReport
from dds_trace.base.printable import printable
from dds_trace.base.units import clock_words

from .. import blocks
from ..blocks import MARKDOWN, PAGE, TERMINAL, Block, Column, Heading, Points, Row, Section, Sentence, Span, Table
from ..comparison.report import gate_blocks
from .words import (
    COLUMNS,
    HOW_TO_READ,
    JudgedTopic,
    TopicRow,
    cells,
    facts_words,
    hole_lines,
    pause_lines,
    seconds_words,
    topic_notes,
    topics_of,
    verdict_words,
)

_RENAMED = {"topic": "name", "stamps_backwards": "backward_stamps"}
_OF_HOLE = ("start_s", "duration_s", "missing", "inside")
_TONES = {"whole": "decided", "holes": "open", "damaged": "lossy"}
_LEVELS = "·▁▂▃▄▅▆▇█"
STRIP_WIDTH = 720
_THINNEST = 1.0
_LONGEST_NAME = 28


@dataclass(frozen=True)
class BagReport(blocks.Report):
    report: TopicReport
    judged: Sequence[JudgedTopic] = ()
    name = "topics"
    title: str = "Is this bag whole?"
    kicker = "Topics of recordings"
    scripts = ()

    @property
    def document(self) -> Mapping[str, Any]:
        report = self.report
        return {
            "format": 1,
            "verdict": report.verdict,
            "recordings": [
                {
                    **asdict(health),
                    "pauses": [{"start_s": start, "duration_s": length} for start, length in health.pauses],
                }
                for health in report.recordings
            ],
            "topics": [
                {
                    **{_RENAMED.get(name, name): value for name, value in row.items()},
                    "holes": [{name: hole[name] for name in _OF_HOLE} for hole in holes],
                    "strip": [round(share, 4) for share in strip],
                }
                for health in report.recordings
                for row, holes, strip in topics_of(report, health.path)
            ],
            "gates": [
                {
                    "gate": gated.result.gate.text,
                    "recording": gated.recording,
                    "topic": gated.result.subject,
                    "outcome": gated.result.outcome.value,
                }
                for gated in self.judged
            ],
            "sources": report.sources,
        }

    @property
    def sections(self) -> Sequence[Section]:
        recordings = enumerate(self.report.recordings, 1)
        parts = [Section([*self._recording(health)], f"recording-{number}") for number, health in recordings]
        gates = [*gate_blocks(self.judged, None)] if self.judged else []
        limits = Section([Heading("Limits"), *gates] if gates else [], "gates", media=PAGE)
        title = Section([Heading("Are these recordings whole?", 1, media=MARKDOWN)])
        how = Section([Sentence(HOW_TO_READ, "soft")] if parts else [])
        return [title, limits, *parts, Section(gates, media=TERMINAL | MARKDOWN), how]

    def _recording(self, health: RecordingHealth) -> Iterator[Block]:
        topics = topics_of(self.report, health.path)
        rows = [row for row, _, _ in topics]
        yield Heading(printable(health.path))
        yield Sentence(verdict_words(health, rows), f"headline {_TONES[health.verdict]}")
        yield Sentence(facts_words(health, len(rows)), "facts")
        yield Points([printable(line) for line in (*pause_lines(health), *health.damages, *health.notes)])
        topic, *numbers = COLUMNS
        least = min(_LONGEST_NAME, max((len(row["topic"]) for row in rows), default=0))
        names = [Column(topic, least=least, media=TERMINAL | MARKDOWN), Column(topic, media=PAGE)]
        columns = [*names, *(Column(name, right=True) for name in numbers)]
        yield Table(columns, [_row(health, *topic) for topic in topics], label="Table of the topics")
        colors = [("there", "messages"), ("hole", "missing"), ("inside", "missing on all topics at once")]
        yield blocks.Key([("", f"00:00 to {_end(health)}"), *colors, ("some", "not periodic")], media=PAGE)


def _end(health: RecordingHealth) -> str:
    return clock_words(health.duration_ns / 1e9)


def _row(health: RecordingHealth, row: TopicRow, holes: Sequence[TopicRow], strip: Sequence[float]) -> Row:
    lines = [*hole_lines(row, holes, health), *topic_notes(row, health)]
    first, *others = cells(row, strip, health)
    words = f"{first}: time from 00:00 to {_end(health)}, {'; '.join(lines) or 'without holes'}"
    is_periodic = row["missing_from"] != ""
    text = "".join(_LEVELS[int(share * 8)] if is_periodic else "▪" if share else " " for share in strip)
    figure = blocks.Figure(text, _strip_svg(words, strip_parts(health, row, holes, strip)))
    with_qos = blocks.stack(Span(first, ""), Span(printable(row["qos"]), "soft"))
    return Row([first, with_qos, *others], figure=figure, notes=lines)


def _strip_svg(words: str, parts: Sequence[tuple[float, float, str, str]]) -> Markup:
    block = Markup('<rect class="{}" x="{}" width="{}" height="18">{}</rect>')
    drawn = [
        block.format(kind, x, width, Markup("<title>{}</title>").format(title) if title else "")
        for x, width, kind, title in parts
    ]
    return Markup(
        '<svg class="time" viewBox="0 0 {0} 18" preserveAspectRatio="none" role="img" aria-label="{1}">'
        '<rect class="track" width="{0}" height="18"/>{2}</svg>'
    ).format(STRIP_WIDTH, words, Markup().join(drawn))


def strip_parts(
    health: RecordingHealth, row: TopicRow, holes: Sequence[TopicRow], strip: Sequence[float]
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
