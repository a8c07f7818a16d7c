"""What reports are made of: sections of blocks, which each module of `REPORT_MODULES` draws."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import Flag, auto
from itertools import groupby
from typing import Any, ClassVar, TypeAlias

from dds_trace.base.extension import load
from dds_trace.base.units import MISSING

WITHIN_QUANTITY = re.compile(r"(?<=±) |(?<=\d) (?=(?:[nµm]?s|min|[hd]|%|[KMG]i?B(?:/s)?|B|k?Hz|ppm|[kM]bit/s)(?!\w))")
"""The blank between a number and its unit, where no line ends."""


class Medium(Flag):
    TERMINAL = auto()
    MARKDOWN = auto()
    PAGE = auto()


TERMINAL, MARKDOWN, PAGE = Medium.TERMINAL, Medium.MARKDOWN, Medium.PAGE
EVERYWHERE = TERMINAL | MARKDOWN | PAGE


@dataclass(frozen=True, slots=True)
class Span:
    """The tone is a class of the page's style, where it opens the result `group`."""

    text: str
    tone: str = "strong"
    group: int | None = None


PASS, FAIL, OPEN = Span("✓", "good"), Span("✗", "bad"), Span("·", "soft")
MARKS = {"meets": PASS, "misses": FAIL, "pass": PASS, "fail": FAIL}
"""Outcome -> its mark; others are `OPEN`."""


@dataclass(frozen=True, slots=True)
class Block:
    """`media` are those that show it."""

    _: KW_ONLY
    media: Medium = EVERYWHERE


@dataclass(frozen=True, slots=True)
class Figure(Block):
    """`text` is of a terminal, `short` of Markdown."""

    text: str = ""
    svg: str = ""
    short: str = ""


@dataclass(frozen=True, slots=True)
class Stack:
    """Lines one below the other; Markdown has commas between them."""

    lines: Sequence[Sequence[Span]]


Words: TypeAlias = str | Sequence[Span] | Stack | Figure


@dataclass(frozen=True, slots=True)
class Heading(Block):
    text: str
    level: int = 2


@dataclass(frozen=True, slots=True)
class Sentence(Block):
    words: Words
    tone: str = ""
    mark: Span | None = None


@dataclass(frozen=True, slots=True)
class Points(Block):
    """A bullet of `1.` numbers the items."""

    items: Sequence[Words]
    bullet: str = "-"


@dataclass(frozen=True, slots=True)
class Key(Block):
    entries: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Facts(Block):
    entries: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Column(Block):
    """Widths are of a terminal, which ends a longer text with an ellipsis if it `is_cut`; `head` is above equal ones."""

    name: str
    _: KW_ONLY
    head: str = ""
    right: bool = False
    width: int | None = None
    least: int | None = None
    is_cut: bool = False


@dataclass(frozen=True, slots=True)
class Row(Block):
    """Below the cells are `figure`, `notes` and, on a page, `details`; `part` is above rows."""

    cells: Sequence[Words]
    _: KW_ONLY
    part: str = ""
    figure: Figure | None = None
    notes: Sequence[str] = ()
    details: Callable[[], Sequence[Block]] | None = None


@dataclass(frozen=True, slots=True)
class Table(Block):
    """`gap` is of a terminal, `look` a class of the page; `opens` names details; `parted` have the rows' parts."""

    columns: Sequence[Column]
    rows: Sequence[Row]
    caption: Words = ""
    _: KW_ONLY
    label: str = ""
    gap: int = 1
    look: str = ""
    opens: str = ""
    parted: Medium = TERMINAL

    def seen(self, medium: Medium) -> tuple[list[Column], list[tuple[Row, list[Words]]]]:
        indices = [index for index, column in enumerate(self.columns) if medium in column.media]
        rows = [(row, [row.cells[index] for index in indices]) for row in self.rows if medium in row.media]
        return [self.columns[index] for index in indices], rows

    def parts(self, medium: Medium) -> list[tuple[str, list[tuple[Row, list[Words]]]]]:
        parts: dict[str, list[tuple[Row, list[Words]]]] = {}
        for row, cells in self.seen(medium)[1]:
            parts.setdefault(row.part if medium in self.parted else "", []).append((row, cells))
        return [*parts.items()]

    @property
    def heads(self) -> list[tuple[str, int]]:
        return [(head, len([*columns])) for head, columns in groupby(self.columns, lambda column: column.head)]


@dataclass(frozen=True, slots=True)
class Fold(Block):
    """A terminal shows the summary and the first of the blocks; `name` and `tone` are the page's."""

    summary: Words
    blocks: Sequence[Block]
    _: KW_ONLY
    name: str = ""
    tone: str = ""


@dataclass(frozen=True, slots=True)
class Command(Block):
    device: str
    text: str


@dataclass(frozen=True, slots=True)
class Bars(Block):
    """In one line of a terminal if one of `short` fits; rows are a name, a length, its words and words to leave out there."""

    rows: Sequence[tuple[str, float, str, str]]
    where: str
    short: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Fitted(Block):
    """What fits into `most` lines of a terminal: the first of `parts`, and always the one numbered `pinned`."""

    parts: Sequence[Sequence[Block]]
    pinned: int
    most: int
    more: str


@dataclass(frozen=True, slots=True)
class Section(Block):
    """An empty line precedes the next in a terminal."""

    blocks: Sequence[Block]
    name: str = ""


class Report(ABC):
    """`document` is of the JSON report."""

    name: ClassVar[str]
    kicker: ClassVar[str]
    scripts: ClassVar[Sequence[str]] = ("theme.js", "blocks.js")
    title: str

    @property
    @abstractmethod
    def document(self) -> Mapping[str, Any]: ...

    @property
    @abstractmethod
    def sections(self) -> Sequence[Section]: ...

    @property
    def screen(self) -> Sequence[Section]:
        return self.sections

    def _repr_markdown_(self) -> str:
        shown: str = load("parts", "presenter").markdown(self)
        return shown


def plain_text(words: Words) -> str:
    if isinstance(words, Figure):
        return words.text
    if isinstance(words, Stack):
        return "\n".join(map(plain_text, words.lines))
    return words if isinstance(words, str) else "".join(span.text for span in words)


def stack(*spans: Span) -> Stack:
    return Stack([[span] for span in spans if span.text not in ("", MISSING)])


def visible(sections: Iterable[Section], medium: Medium) -> list[tuple[str, list[Block]]]:
    return [
        (section.name, blocks)
        for section in sections
        if medium in section.media and (blocks := [block for block in section.blocks if medium in block.media])
    ]
