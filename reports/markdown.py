"""Blocks as Markdown, with every string from a trace escaped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from . import blocks
from .blocks import MARKDOWN, Block, Report, Span, Words, plain_text, visible
from .book.groups import markdown


def render(report: Report) -> str:
    parts = [_DRAWN[type(block)](block) for _, content in visible(report.sections, MARKDOWN) for block in content]
    return "\n\n".join(filter(None, parts)) + "\n"


def _words(words: Words) -> str:
    if isinstance(words, blocks.Figure):
        return f"<code>{words.short or words.text}</code>".replace(" ", "\u2007")
    if isinstance(words, blocks.Stack):
        return ", ".join(map(_words, words.lines))
    return markdown(words) if isinstance(words, str) else "".join(map(_span, words))


def _span(span: Span) -> str:
    if span.tone in ("code", "raw"):  # of our own
        return f"`{span.text}`" if span.tone == "code" else span.text
    return f"**{markdown(span.text)}**" if "strong" in span.tone.split() else markdown(span.text)


def _sentence(block: blocks.Sentence) -> str:
    words = _words(block.words)
    return f"**{words}**" if {"strong", "headline"} & {*block.tone.split()} else words


def _list(items: Sequence[str], bullet: str = "-") -> str:
    return "\n".join(f"{bullet} {item}" for item in items)


def _table(block: blocks.Table) -> str:
    columns, rows = block.seen(MARKDOWN)
    has_figures = any(row.figure for row, _ in rows)
    names = [[markdown(column.name) for column in columns], ["---:" if column.right else "---" for column in columns]]
    texts = [f"{_words(block.caption)}:" if block.caption and rows else ""]
    for part, own_rows in block.parts(MARKDOWN):
        lines = [*names, *([*map(_words, cells)] for _, cells in own_rows)]
        if has_figures:
            last = ("Time", "---", *(_words(row.figure or "") for row, _ in own_rows))
            lines = [[*line, cell] for line, cell in zip(lines, last, strict=True)]
        texts += [f"**{markdown(part)}**" if part else "", "\n".join(f"| {' | '.join(cells)} |" for cells in lines)]
    texts.append(_list([f"{_words(cells[0])}: {markdown(note)}" for row, cells in rows for note in row.notes]))
    return "\n\n".join(filter(None, texts))


def _fold(block: blocks.Fold) -> str:
    inner = [_DRAWN[type(inside)](inside) for inside in block.blocks if MARKDOWN in inside.media]
    return "\n\n".join([f"<details><summary>{markdown(plain_text(block.summary))}</summary>", *inner, "</details>"])


_DRAWN: dict[type[Block], Callable[[Any], str]] = {
    blocks.Heading: lambda block: f"{'#' * block.level} {markdown(block.text)}",
    blocks.Sentence: _sentence,
    blocks.Points: lambda block: _list([*map(_words, block.items)], "1." if block.bullet == "1." else "-"),
    blocks.Table: _table,
    blocks.Command: lambda block: f"on {markdown(block.device)}:\n\n    {block.text}",
    blocks.Fold: _fold,
    blocks.Facts: lambda block: _list([f"{name}: {markdown(text)}" for name, text in block.entries]),
}
