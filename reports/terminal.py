"""Blocks in 80 columns of a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.containers import Lines
from rich.segment import Segment
from rich.table import Table as Grid
from rich.text import Text

from dds_trace.base.printable import printable
from dds_trace.base.streams import SCREEN_WIDTH, command_lines, print_screen, screen_text
from dds_trace.base.units import counted

from . import blocks
from .blocks import TERMINAL, WITHIN_QUANTITY, Block, Report, Section, Span, Words, plain_text, visible

STYLES = {
    "strong": "bold",
    "headline": "bold",
    "soft": "dim",
    "good": "green",
    "bad": "red",
    "open": "yellow",
    "decided": "green",
    "lossy": "red",
    "info": "blue",
}
INLINE_BAR, BAR = 5, 30

Drawn = Iterable[RenderableType]
"""Text objects only: rich would interpret [markup] in a str."""


def render(report: Report) -> str:
    return screen_text(_drawn(report.screen))


def print_report(report: Report) -> None:
    print_screen(_drawn(report.screen))


def _drawn(sections: Iterable[Section]) -> Group:
    parts: list[RenderableType] = []
    for _, content in visible(sections, TERMINAL):
        lines = _lines(content)
        parts += [Text(), *lines] if parts and lines else lines
    return Group(*parts)


def _lines(content: Iterable[Block]) -> list[RenderableType]:
    return [line for block in content for line in _DRAWN[type(block)](block)]


_GLUE = "\ue000"


class _Text(Text):
    """A number stays with its unit where a line ends."""

    def wrap(self, *arguments: Any, **options: Any) -> Lines:
        glued = self.copy()
        glued.plain = WITHIN_QUANTITY.sub(_GLUE, self.plain)
        lines = glued.wrap(*arguments, **options)
        for line in lines:
            line.plain = line.plain.replace(_GLUE, " ")
        return lines


def _text(words: Words, tone: str = "") -> Text:
    if isinstance(words, (str, blocks.Figure)):
        return _Text(plain_text(words), style=_style(tone))
    if isinstance(words, blocks.Stack):
        spans = [span for line in words.lines for span in (Span("\n", ""), *line)][1:]
    else:
        spans = [*words]
    return _Text.assemble(*((span.text, _style(span.tone)) for span in spans))


def _style(tone: str) -> str:
    return " ".join(STYLES[word] for word in tone.split() if word in STYLES)


def _points(block: blocks.Points) -> Drawn:
    if not block.bullet:
        return [*map(_text, block.items)]
    grid = Grid.grid(padding=(0, 1, 0, 0))
    for number, item in enumerate(block.items, 1):
        grid.add_row(Text(f"{number:2}." if block.bullet == "1." else block.bullet), _text(item))
    return [grid] if block.items else []


def _wrapped(block: blocks.Sentence) -> list[Text]:
    mark = block.mark or Span("")
    start = f"{mark.text} " if mark.text else ""
    text, indent = WITHIN_QUANTITY.sub(_GLUE, start + plain_text(block.words)), " " * len(start)
    lines = textwrap.wrap(text, SCREEN_WIDTH - 1, subsequent_indent=indent, break_on_hyphens=False)
    first, *others = (Text(line.replace(_GLUE, " "), style=_style(block.tone)) for line in lines)
    first.stylize(_style(mark.tone), 0, len(mark.text))
    return [first, *others]


def _fitted(block: blocks.Fitted) -> Drawn:
    lines: list[RenderableType] = []
    parts, remaining = list(map(_lines, block.parts)), 0
    for number, drawn in enumerate(parts):
        reserved = len(parts[block.pinned]) if number < block.pinned else 0
        if number != block.pinned and (remaining or len(lines) + len(drawn) + reserved > block.most - 1):
            remaining += 1
        else:
            lines += drawn
    remainder = f"{counted(remaining, 'more fact')}, {block.more}" if remaining else block.more
    return [*lines, *([Text(f"--all shows {remainder}", style="dim")] if block.more else [])]


def _bars(block: blocks.Bars) -> Drawn:
    longest = max((value for _, value, *_ in block.rows), default=1)
    for shown in (2, 1) if block.short else ():
        bars = (f"{name} {_bar(ns, longest, INLINE_BAR)} {''.join(words[:shown])}" for name, ns, *words in block.rows)
        line = "  " + "   ".join(bars)
        for end in block.short:
            if len(f"{line}   {end}") < SCREEN_WIDTH:
                return [Text(f"{line}   {end}")]
    width = max(len(name) for name, *_ in block.rows)
    bar = max(1, min(BAR, SCREEN_WIDTH - width - max(len("".join(words)) for _, _, *words in block.rows) - 7))
    rows = [f"  {name:<{width}}  {_bar(ns, longest, bar):<{bar}}  {''.join(words)}" for name, ns, *words in block.rows]
    return [Text(f"  {block.where}:", style="dim"), *map(Text, rows)]


def _bar(value: float, longest: float, cells: int) -> str:
    whole, eighths = divmod(max(1, round(8 * cells * value / longest)), 8)
    return "█" * whole + " ▏▎▍▌▋▊▉"[eighths].strip()


def _command(block: blocks.Command) -> Drawn:
    return [Text(f"  on {block.device}:", style="dim"), Text(command_lines(block.text))]


def _widths(columns: Sequence[blocks.Column], rows: Sequence[Sequence[Words]], gap: int) -> list[int]:
    """Take from the widest column that is above its least width, else from the widest."""
    widths, leasts = [], []
    for at, column in enumerate(columns):
        text = "\n".join([column.name, *(plain_text(cells[at]) for cells in rows)])
        widths.append(column.width or max(map(len, text.split("\n"))))
        leasts.append(
            column.width or column.least or max(map(len, WITHIN_QUANTITY.sub(_GLUE, text).split()), default=1)
        )
    for _ in range(sum(widths) + gap * (len(widths) - 1) - SCREEN_WIDTH):
        widths[max(range(len(widths)), key=lambda at: (widths[at] > leasts[at], widths[at]))] -= 1
    return widths


def _table(block: blocks.Table) -> Iterator[RenderableType]:
    columns, rows = block.seen(TERMINAL)
    if block.caption:
        yield _text(plain_text(block.caption), "strong")
    for number, sheet in enumerate(_sheets(columns, block.gap)):
        yield from [Text()] if number else []
        yield from _sheet(block, [columns[index] for index in sheet], sheet)
    for row, cells in rows:
        if row.notes:
            yield Text(printable(plain_text(cells[0])), style="bold")
            yield from (_text(f"  {line}") for line in (*([row.figure.text] if row.figure else []), *row.notes))


def _sheets(columns: Sequence[blocks.Column], gap: int) -> list[list[int]]:
    """Each sheet has the first column."""
    sheets = [[0]]
    for index, column in enumerate(columns[1:], 1):
        used = sum((columns[at].width or 0) + gap for at in sheets[-1])
        if column.head and used + (column.width or 0) > SCREEN_WIDTH:
            sheets.append([0])
        sheets[-1].append(index)
    return sheets


def _sheet(block: blocks.Table, columns: Sequence[blocks.Column], sheet: Sequence[int]) -> Iterator[RenderableType]:
    parts = [(part, [[cells[index] for index in sheet] for _, cells in rows]) for part, rows in block.parts(TERMINAL)]
    widths = _widths(columns, [cells for _, rows in parts for cells in rows], block.gap)

    def grid(rows: Iterable[Sequence[Words]], *, has_names: bool) -> Grid:
        table = Grid(box=None, padding=(0, block.gap, 0, 0), pad_edge=False, header_style="dim", show_header=has_names)
        for column, width in zip(columns, widths, strict=True):
            table.add_column(
                Text(column.name),
                width=width,
                justify="right" if column.right else "left",
                no_wrap=column.is_cut,
                overflow="ellipsis" if column.is_cut else "fold",
            )
        for cells in rows:
            table.add_row(*map(_text, cells))
        return table

    if any(part for part, _ in parts) or any(column.name for column in columns):
        yield grid([], has_names=True)
    for part, rows in parts:
        yield from [_text(part, "strong")] if part else []
        for is_short, group in groupby(rows, lambda cells: _is_short(cells, widths)):
            some = [*group]
            lines = [_line(cells, columns, widths, block.gap) for cells in some] if is_short else []
            yield _Lines(lines, grid(some, has_names=False))


def _is_short(cells: Sequence[Words], widths: Sequence[int]) -> bool:
    return all(
        isinstance(text, str) and text.isprintable() and cell_len(text) <= width
        for text, width in zip(cells, widths, strict=True)
    )


def _line(cells: Sequence[Words], columns: Sequence[blocks.Column], widths: Sequence[int], gap: int) -> str:
    texts = []
    for cell, column, width in zip(cells, columns, widths, strict=True):
        text = str(cell).rstrip() if column.right else str(cell)
        spaces = " " * (width - cell_len(text))
        texts.append(spaces + text if column.right else text + spaces)
    return (" " * gap).join(texts)


class _Lines:
    """Rows as their grid draws them on a wide screen, at a tenth of its cost."""

    def __init__(self, lines: Sequence[str], grid: Grid) -> None:
        self._lines, self._grid = lines, grid

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        is_wide = self._lines and cell_len(self._lines[0]) <= options.max_width
        yield Segment("\n".join(self._lines) + "\n") if is_wide else self._grid


def _fold(block: blocks.Fold) -> Drawn:
    grid = Grid.grid(padding=(0, 1, 0, 0))
    for line in _lines(block.blocks[:1]):
        grid.add_row(Text(" "), line)
    return [_text(block.summary), grid]


def _facts(block: blocks.Facts) -> Drawn:
    grid = Grid.grid(padding=(0, 1, 0, 0))
    grid.add_column(width=19, no_wrap=True)
    for name, text in block.entries:
        grid.add_row(Text(name, "dim"), _text(text))
    return [grid]


_DRAWN: dict[type[Block], Callable[[Any], Drawn]] = {
    blocks.Heading: lambda block: [Text(block.text, style="bold")],
    blocks.Sentence: lambda block: _wrapped(block) if block.mark else [_text(block.words, block.tone)],
    blocks.Points: _points,
    blocks.Bars: _bars,
    blocks.Table: _table,
    blocks.Command: _command,
    blocks.Fitted: _fitted,
    blocks.Fold: _fold,
    blocks.Facts: _facts,
}
