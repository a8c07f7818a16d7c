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
from .plan.plan import Search
from .search import MaxRate, RateAnswer

COLUMNS = ("middleware", "bridge", "data", "size", "max_rate_hz", "answer", "fails_at_hz", "held", "why")

_ROW_PX, _LABEL_PX, _BAR_PX, _TOP_PX = 22, 330, 420, 64
_COLOURS = {
    RateAnswer.FOUND: "#0072b2",
    RateAnswer.AT_LEAST: "#009e73",
    RateAnswer.BELOW: "#d55e00",
    RateAnswer.FAILED: "#999999",
}
"""Colour of a bar by its answer, from Okabe and Ito's palette for the colour-blind."""


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
    height = _TOP_PX + _ROW_PX * len(answers) + 20
    powers = range(math.ceil(math.log10(search.min_rate)), math.floor(math.log10(search.max_rate)) + 1)
    lines = [_HEAD.format(width=_LABEL_PX + _BAR_PX + 200, height=height, search=search)]
    lines += [
        _TICK.format(x=_LABEL_PX + _x(rate_hz, search), top=_TOP_PX, bottom=height - 16, rate_hz=rate_hz)
        for rate_hz in (10.0**power for power in powers)
    ]
    for row, (highest, cells) in enumerate(zip(answers, max_rate_rows(answers), strict=True)):
        rate = f"{cells[4]} Hz" if highest.answer is RateAnswer.FOUND else f"{cells[5]} {cells[4] and cells[4] + ' Hz'}"
        lines.append(
            _BAR.format(
                label=escape(" ".join(part for part in cells[:4] if part)),
                said=rate.strip(),
                label_x=_LABEL_PX - 8,
                x=_LABEL_PX,
                y=_TOP_PX + _ROW_PX * row,
                width=_x(highest.cell.rate, search) if cells[4] else 2,
                end_x=_LABEL_PX + (_x(highest.cell.rate, search) if cells[4] else 2) + 6,
                text_y=_TOP_PX + _ROW_PX * row + 12,
                height=_ROW_PX - 7,
                colour=_COLOURS[highest.answer],
            )
        )
    return "".join([*lines, "</svg>\n"])


def _x(rate_hz: float, search: Search) -> float:
    share = math.log(max(rate_hz, search.min_rate) / search.min_rate) / math.log(search.max_rate / search.min_rate)
    return max(2.0, min(1.0, share) * _BAR_PX)


_HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">
<rect width="100%" height="100%" fill="white"/>
<text x="10" y="20" font-size="15">Highest sustained rate (messages a second, log axis)</text>
<text x="10" y="38" fill="#555">sustained: at most {search.loss_percent:g} % lost, response p{search.percentile:g} \
within {search.deadline_ms:g} ms; longer is better</text>
"""

_TICK = """\
<line x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{bottom}" stroke="#ddd"/>
<text x="{x:.1f}" y="{top}" dy="-8" text-anchor="middle" fill="#555">{rate_hz:g}</text>
"""

_BAR = """\
<text x="{label_x}" y="{text_y}" text-anchor="end">{label}</text>
<rect x="{x}" y="{y}" width="{width:.1f}" height="{height}" fill="{colour}"/>
<text x="{end_x:.1f}" y="{text_y}">{said}</text>
"""
