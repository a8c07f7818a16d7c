"""The verdict as a picture: SVG, and PNG where matplotlib is installed."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TypeAlias

from dds_trace.analyzer.verdicts.answers import CaseAnswer
from dds_trace.base.printable import printable
from dds_trace.base.units import MISSING, counted, format_duration
from dds_trace.base.version import __version__
from dds_trace.extensions.bags.analyze import TopicReport
from dds_trace.extensions.bags.card import VERDICTS
from dds_trace.extensions.bags.report import (
    STRIP_WIDTH,
    facts_words,
    missing_words,
    strip_parts,
    topics_of,
    verdict_words,
)

from .book.answer import PointKind
from .book.book import Book
from .book.groups import Cell
from .book.verdicts import contender_labels, place_of
from .html.styles import choice_styles

WIDTH, HEIGHT, EDGE = 1200, 630, 56
LABELS, TIMES = 440, 150
"""Widths of the columns on both sides of the dots."""
MOST_ROWS = 6
INK, SOFT, GRID, BAD, GREY = "#16202c", "#5a6675", "#d5dae0", "#b3261e", "#5f6670"
_STRIP_COLORS = {"there": "#3b78b5", "some": SOFT, "hole": BAD, "inside": INK}
FAMILY = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif"
CHARACTER, BOLD_CHARACTER = 0.56, 0.62
"""Mean width of a character of DejaVu Sans, the widest of the family, in its size."""


@dataclass(frozen=True, slots=True)
class Words:
    x: float
    y: float
    size: float
    text: str
    color: str = INK
    is_bold: bool = False
    anchor: str = "start"


@dataclass(frozen=True, slots=True)
class Bar:
    ends: tuple[float, float, float, float]
    color: str
    width: float


@dataclass(frozen=True, slots=True)
class Spot:
    x: float
    y: float
    radius: float
    color: str


Mark: TypeAlias = Words | Bar | Spot


@dataclass(frozen=True, slots=True)
class Measured:
    setup: str
    message: str
    color: str
    median_ns: float | None
    low_ns: float
    high_ns: float
    leads: bool

    @property
    def is_finite(self) -> bool:
        return self.median_ns is not None and math.isfinite(self.median_ns)


def svg_text(title: str, marks: Sequence[Mark]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}"'
        f' role="img" font-family="{FAMILY}">\n<title>{escape(title)}</title>\n'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>\n'
    )
    return head + "".join(f"{_svg(mark)}\n" for mark in marks) + "</svg>\n"


def write_picture(title: str, marks: Sequence[Mark], folder: Path, say: Callable[[str], None]) -> list[Path]:
    svg, png = folder / "card.svg", folder / "card.png"
    svg.write_text(svg_text(title, marks), encoding="utf-8")
    try:
        _draw_png(marks, png)
    except ModuleNotFoundError:
        say("card.png needs matplotlib: pip install 'dds-trace[card]'; card.svg is written")
        return [svg]
    return [svg, png]


def book_card(book: Book) -> tuple[str, list[Mark]]:
    facts = {fact.label: fact.value for fact in book.overview.facts}
    kind, sentence = _verdict(book)
    case = book.fastest[0].shown if book.fastest else None
    alike = [answer for answer in book.analysis.details.answers if case and _message(answer) == _message(case)]
    rows = [row for answer in alike for row in _measured(book, answer)]
    rows = sorted(rows, key=lambda row: (math.inf if row.median_ns is None else row.median_ns, row.setup))[:MOST_ROWS]
    when = facts.get("When", "")
    wide = WIDTH - 2 * EDGE
    marks: list[Mark] = [
        _line(EDGE, 66, 20, f"dds-trace: {book.title}", wide - 20 * CHARACTER * (len(when) + 2), SOFT),
        Words(WIDTH - EDGE, 66, 20, when, SOFT, anchor="end"),
    ]
    losses = "" if kind is PointKind.LOSS else dict(book.answer.sentences).get(PointKind.LOSS, "")
    pitch = min(56, 230 / max(1, len(rows)))
    headline, by_how_much = sentence, list[str]()
    if kind is PointKind.FASTEST and sentence.endswith(")."):
        headline, _, ratios = sentence.removesuffix(").").rpartition(" (")
        by_how_much = textwrap.wrap(f"{ratios[0].upper()}{ratios[1:]}.", int(wide / (18 * CHARACTER)))
    bottom = 546 - pitch * len(rows) - (50 if rows else 0) - (38 if losses else 0) - 26 * len(by_how_much)
    size, lines = _fitted(headline, bottom - 84)
    y = 84.0
    for line in lines:
        y += 1.25 * size
        marks.append(Words(EDGE, y, size, line, INK, is_bold=True))
    for line in by_how_much:
        y += 26
        marks.append(Words(EDGE, y, 18, line, SOFT))
    if losses:
        whole = _line(EDGE, y + 42, 22, losses, wide, BAD)
        shortest = f"{losses.partition(', all of them')[0]}."
        marks.append(whole if whole.text == losses else _line(EDGE, y + 42, 22, shortest, wide, BAD))
    if rows:
        marks += _dots(rows, 546 - pitch * len(rows), pitch)
    where = f"Measured on {place_of(case) if case else facts['Devices']}" if case or "Devices" in facts else ""
    others = len({place_of(answer) for answer in book.analysis.details.answers}) - 1
    more = f"; {counted(others, 'more pair')} of devices and links in the report" if others > 0 and case else ""
    versions = ", ".join(filter(None, (f"dds-trace {__version__}", facts.get("Versions", ""))))
    marks.append(Bar((EDGE, 558, WIDTH - EDGE, 558), GRID, 1))
    marks.append(_line(EDGE, 586, 20, where + more, wide))
    marks.append(_line(EDGE, 612, 16, versions, wide, SOFT))
    return sentence, marks


def topics_card(report: TopicReport) -> tuple[str, list[Mark]]:
    health = max(report.recordings, key=lambda one: VERDICTS.index(one.verdict))
    topics = topics_of(report, health.path)
    said, facts = verdict_words(health, [row for row, _, _ in topics]), facts_words(health, len(topics))
    worst = sorted(topics, key=lambda topic: (-(topic[0]["missing_low"] or 0), sum(topic[2])))[:MOST_ROWS]
    size, lines = _fitted(said, 150)
    marks: list[Mark] = [_line(EDGE, 66, 20, f"dds-trace: {printable(health.path)}", WIDTH - 2 * EDGE, SOFT)]
    marks += [Words(EDGE, 84 + 1.25 * size * (n + 1), size, line, is_bold=True) for n, line in enumerate(lines)]
    left, scale = EDGE + LABELS, (WIDTH - 2 * EDGE - LABELS - TIMES) / STRIP_WIDTH
    for number, (row, holes, strip) in enumerate(worst):
        y = 300 + 40 * number
        marks.append(_line(EDGE, y + 7, 20, printable(row["topic"]), LABELS - 12))
        for start, width, kind, _ in strip_parts(health, row, holes, strip):
            marks.append(Bar((left + start * scale, y, left + (start + width) * scale, y), _STRIP_COLORS[kind], 22))
        missing = "no rhythm" if row["missing"] is None else f"{missing_words(row).partition(' (')[0]} missing"
        marks.append(Words(WIDTH - EDGE, y + 7, 20, missing, anchor="end"))
    return said, [*marks, _line(EDGE, 586, 20, facts, WIDTH - 2 * EDGE, SOFT)]


def _verdict(book: Book) -> tuple[PointKind, str]:
    answer = book.answer
    sentences = [sentence for sentence in answer.sentences if sentence[0] is not PointKind.LOSS] or answer.sentences
    fastest = next((sentence for sentence in sentences if sentence[0] is PointKind.FASTEST), sentences[0])
    return sentences[0] if PointKind.FORGED in answer.kinds else fastest


def _measured(book: Book, answer: CaseAnswer) -> Iterator[Measured]:
    labels = contender_labels(book.analysis.details.answers, book.groups.vendors)
    styles = choice_styles(book.facets)
    message = Cell(answer.data_type, answer.payload_bytes, answer.rate_hz).label
    for setup in answer.contenders:
        label, at = labels[setup.name], setup.p50_ns
        color = GREY if setup.group is None else styles[book.facets.option("choice", setup.group)].light
        ends = (None, None) if setup.group is None else book.intervals.ends("latency", "p50", setup.group)
        bottom, top = ((at or 0) if end is None else end for end in ends)
        leads = answer.domain_mode == "same" and answer.leader_p50 == setup.name
        yield Measured(label, message, color, at, min(bottom, at or 0), max(top, at or 0), leads)


def _message(answer: CaseAnswer) -> tuple[object, ...]:
    return place_of(answer), answer.data_type, answer.payload_bytes, answer.rate_hz


def _dots(rows: Sequence[Measured], top: float, pitch: float) -> Iterator[Mark]:
    left, right = EDGE + LABELS, WIDTH - EDGE - TIMES
    finite = [row for row in rows if row.is_finite]
    least = min((row.low_ns for row in finite if row.low_ns > 0), default=1.0)
    most = max((row.high_ns for row in finite), default=1.0)
    is_log = most > 10 * least
    scale = "log scale" if is_log else "from 0"
    first, names = rows[0], ("message", "setup")
    varying = [name for name in names if len({getattr(row, name) for row in rows}) > 1] or ["setup"]
    what = first.message if "message" not in varying else "each message" if "setup" in varying else first.setup
    caption = f"Median latency of {what}, with its 95 % interval ({scale})"
    yield _line(EDGE, top - 14, 18, caption, WIDTH - 2 * EDGE, SOFT)
    yield Bar((left, top, left, top + pitch * len(rows)), GRID, 2)

    def at(ns: float) -> float:
        share = math.log(max(ns, least) / least) / math.log(most / least) if is_log else ns / most
        return left + (12 if is_log else 0) + (right - left - 12) * share

    for index, row in enumerate(rows):
        y, label = top + pitch * (index + 0.5), ", ".join(getattr(row, name) for name in varying)
        yield _line(EDGE, y + 7, 20, label, LABELS - 12, is_bold=row.leads)
        if row.is_finite and row.median_ns is not None:
            yield Bar((left, y, right, y), "#eef0f3", 1)
            yield Bar((at(row.low_ns), y, at(row.high_ns), y), row.color, 4)
            yield Spot(at(row.median_ns), y, 9, row.color)
        time = MISSING if row.median_ns is None else format_duration(row.median_ns) if row.is_finite else "lost"
        yield Words(WIDTH - EDGE, y + 7, 20, time, INK, row.leads, "end")


def _fitted(sentence: str, height: float) -> tuple[float, list[str]]:
    for size in (44, 38, 33, 28, 24):
        lines = textwrap.wrap(sentence, int((WIDTH - 2 * EDGE) / (size * BOLD_CHARACTER)))
        if 1.25 * size * len(lines) <= height:
            return size, lines
    parts = sentence.removesuffix("; more in the report.").rsplit("; ", 1)
    return _fitted(f"{parts[0]}; more in the report.", height) if len(parts) > 1 else (24, lines[: int(height / 30)])


def _line(
    x: float, y: float, size: float, text: str, width: float, color: str = INK, *, is_bold: bool = False
) -> Words:
    mean = BOLD_CHARACTER if is_bold else CHARACTER
    fitted = max(0.75 * size, min(size, width / (mean * max(1, len(text)))))
    most = int(width / (mean * fitted) + 1e-9)
    return Words(x, y, fitted, text if len(text) <= most else f"{text[: most - 1].rstrip(' ,;')}…", color, is_bold)


def _svg(mark: Mark) -> str:
    if isinstance(mark, Words):
        weight = ' font-weight="700"' if mark.is_bold else ""
        where = f'x="{mark.x:g}" y="{mark.y:g}" text-anchor="{mark.anchor}"'
        return f'<text {where} font-size="{mark.size:g}"{weight} fill="{mark.color}">{escape(mark.text)}</text>'
    if isinstance(mark, Bar):
        x1, y1, x2, y2 = (f"{end:.1f}" for end in mark.ends)
        return f'<path d="M{x1} {y1}L{x2} {y2}" stroke="{mark.color}" stroke-width="{mark.width:g}"/>'
    return f'<circle cx="{mark.x:.1f}" cy="{mark.y:.1f}" r="{mark.radius:g}" fill="{mark.color}"/>'


def _draw_png(marks: Sequence[Mark], path: Path) -> None:
    from matplotlib.figure import Figure  # noqa: PLC0415 - the extra `card`
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Circle  # noqa: PLC0415

    figure = Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(HEIGHT, 0))
    axes.set_axis_off()
    for mark in marks:
        if isinstance(mark, Words):
            axes.text(
                mark.x,
                mark.y,
                mark.text,
                size=mark.size * 0.72,
                color=mark.color,
                weight="bold" if mark.is_bold else "normal",
                family="DejaVu Sans",
                ha="right" if mark.anchor == "end" else "left",
                va="baseline",
                parse_math=False,
            )
        elif isinstance(mark, Bar):
            x1, y1, x2, y2 = mark.ends
            axes.add_line(Line2D((x1, x2), (y1, y2), color=mark.color, linewidth=mark.width * 0.72))
        else:
            axes.add_patch(Circle((mark.x, mark.y), mark.radius, color=mark.color, zorder=3))
    figure.savefig(path, format="png", metadata={"Software": None})
