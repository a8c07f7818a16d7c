"""The report of a search for the highest rates."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import asdict
from html import escape
from pathlib import Path

from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.units import spell_size

from .folder import replace_text
from .plan.cells import Cell
from .plan.plan import Search
from .search import MaxRate, RateAnswer

COLUMNS = ("middleware", "bridge", "data", "size", "max_rate_hz", "answer", "fails_at_hz", "held", "why")

_ROW_PX, _BAR_PX, _TOP_PX, _CHARACTER_PX, _MOST_SAID = 22, 420, 58, 7, 80


def write_max_rates(folder: Path, answers: list[MaxRate], search: Search) -> list[Path]:
    texts = {
        "max_rate.json": json.dumps(
            {"search": asdict(search), "answers": [{**asdict(rate), "answer": rate.answer.value} for rate in answers]},
            indent=1,
        ),
        "max_rate.csv": max_rate_csv(answers),
        "max_rate.svg": max_rate_svg(answers, search),
    }
    for name, text in texts.items():
        replace_text(folder / name, text)
    return [folder / name for name in texts]


def max_rate_rows(answers: list[MaxRate]) -> list[tuple[str, ...]]:
    return [
        (
            highest.cell.middleware,
            highest.cell.bridge,
            highest.cell.data,
            spell_size(highest.cell.size) if highest.cell.size is not None else "",
            f"{highest.cell.rate:g}" if highest.answer in (RateAnswer.FOUND, RateAnswer.AT_LEAST) else "",
            highest.answer.value,
            f"{highest.failing_hz:g}" if highest.failing_hz is not None else "",
            "{}/{}".format(*highest.held_repeats),
            highest.reason,
        )
        for highest in answers
    ]


def _inert(row: tuple[str, ...]) -> list[str]:
    cells = (printable(cell, MAX_FINDING_CHARACTERS) for cell in row)
    return [f"'{cell}" if cell.startswith(("=", "+", "-", "@", "::")) else cell for cell in cells]


def max_rate_csv(answers: list[MaxRate]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(map(_inert, max_rate_rows(answers)))
    return text.getvalue()


def max_rate_svg(answers: list[MaxRate], search: Search) -> str:
    labels = [_label(highest.cell) for highest in answers]
    sentences = [printable(_rate_words(highest), _MOST_SAID) for highest in answers]
    left = 20 + _CHARACTER_PX * max(map(len, labels), default=0)
    bottom = _TOP_PX + _ROW_PX * len(answers)
    right = left + _BAR_PX + 20 + _CHARACTER_PX * max(map(len, sentences), default=0)
    lines = [_HEAD.format(width=max(right, 640), height=bottom + 46, search=search)]
    lines += [
        _TICK.format(x=left + _x(rate_hz, search), top=_TOP_PX - 6, bottom=bottom, text_y=bottom + 16, rate_hz=rate_hz)
        for rate_hz in _ticks(search)
    ]
    lines.append(_AXIS.format(x=left + _BAR_PX / 2, y=bottom + 36))
    for row, (highest, label, words) in enumerate(zip(answers, labels, sentences, strict=True)):
        has_rate = highest.answer in (RateAnswer.FOUND, RateAnswer.AT_LEAST)
        width = _x(highest.cell.rate, search) if has_rate else 2
        y = _TOP_PX + _ROW_PX * row
        end = width if highest.failing_hz is None else max(width, _x(highest.failing_hz, search))
        lines.append(
            _BAR.format(
                label=escape(label),
                sentence=escape(words),
                label_x=left - 8,
                x=left,
                y=y,
                width=width,
                fails_x=left + end,
                end_x=left + end + 6,
                text_y=y + 12,
                middle_y=y + (_ROW_PX - 7) / 2,
                height=_ROW_PX - 7,
            )
        )
    return "".join([*lines, "</svg>\n"])


def _label(cell: Cell) -> str:
    size = "" if cell.size is None else spell_size(cell.size)
    bridge = f"through {cell.bridge}" if cell.crosses_domains else "same domain"
    return " ".join(filter(None, (cell.middleware, bridge, cell.data, size, *cell.changed_axes)))


def _rate_words(highest: MaxRate) -> str:
    fails = "" if highest.failing_hz is None else f"{highest.failing_hz:g} Hz fails"
    if highest.answer is RateAnswer.FAILED:
        return f"not measured: {highest.reason}"
    if highest.answer is RateAnswer.BELOW:
        return f"none: {fails}"
    at_least = "at least " if highest.answer is RateAnswer.AT_LEAST else ""
    return ", ".join(filter(None, (f"{at_least}{highest.cell.rate:g} Hz", fails)))


def _ticks(search: Search) -> list[float]:
    ends = search.min_rate, search.max_rate
    powers = range(math.floor(math.log10(ends[0])), math.ceil(math.log10(ends[1])) + 1)
    steps = (1, 2, 5) if len(powers) < 4 else (1,)
    rates_hz = [step * 10.0**power for power in powers for step in steps]
    within = [rate_hz for rate_hz in rates_hz if ends[0] <= rate_hz <= ends[1]]
    return within if len(within) > 1 else [*ends]


def _x(rate_hz: float, search: Search) -> float:
    share = math.log(max(rate_hz, search.min_rate) / search.min_rate) / math.log(search.max_rate / search.min_rate)
    return max(2.0, min(1.0, share) * _BAR_PX)


_HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">
<rect width="100%" height="100%" fill="white"/>
<text x="10" y="20" font-size="15">Highest sustained rate: longer is better; the line ends at the lowest rate that fails</text>
<text x="10" y="38" fill="#555">sustained: at most {search.loss_percent:g} % lost, response p{search.percentile:g} \
within {search.deadline_ms:g} ms</text>
"""

_TICK = """\
<line x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{bottom}" stroke="#ddd"/>
<text x="{x:.1f}" y="{text_y}" text-anchor="middle" fill="#555">{rate_hz:g}</text>
"""

_AXIS = """\
<text x="{x:.1f}" y="{y}" text-anchor="middle" fill="#555">messages a second (Hz, log scale)</text>
"""

_BAR = """\
<text x="{label_x}" y="{text_y}" text-anchor="end">{label}</text>
<rect x="{x}" y="{y}" width="{width:.1f}" height="{height}" fill="#0072b2"/>
<line x1="{x}" y1="{middle_y}" x2="{fails_x:.1f}" y2="{middle_y}" stroke="#0072b2"/>
<text x="{end_x:.1f}" y="{text_y}">{sentence}</text>
"""
