"""What reports are made of: sections of blocks, which each module of `REPORT_MODULES` draws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import Flag, auto
from typing import Any, ClassVar, TypeAlias

from dds_trace.base.units import MISSING


class Medium(Flag):
    TERMINAL = auto()
    MARKDOWN = auto()
    PAGE = auto()


TERMINAL, MARKDOWN, PAGE = Medium.TERMINAL, Medium.MARKDOWN, Medium.PAGE
EVERYWHERE = TERMINAL | MARKDOWN | PAGE


@dataclass(frozen=True, slots=True)
class Span:
    """Part of a text; the tone is a class of the page's style."""

    text: str
    tone: str = "strong"


@dataclass(frozen=True, slots=True)
class Block:
    """`media` are those that show it."""

    _: KW_ONLY
    media: Medium = EVERYWHERE


@dataclass(frozen=True, slots=True)
class Figure(Block):
    text: str = ""
    svg: str = ""


@dataclass(frozen=True, slots=True)
class Stack:
    """Texts one below the other; Markdown has commas between them."""

    spans: Sequence[Span]


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
    items: Sequence[Words]
    bullet: str = "-"


@dataclass(frozen=True, slots=True)
class Key(Block):
    entries: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Column(Block):
    """Widths are of a terminal, which ends a longer text with an ellipsis if it `is_cut`."""

    name: str
    _: KW_ONLY
    right: bool = False
    width: int | None = None
    least: int | None = None
    is_cut: bool = False


@dataclass(frozen=True, slots=True)
class Row(Block):
    """Below the cells are `figure`, `notes` and, on a page, `details`; `part` is a heading of a terminal."""

    cells: Sequence[Words]
    _: KW_ONLY
    part: str = ""
    figure: Figure | None = None
    notes: Sequence[str] = ()
    details: Callable[[], Sequence[Block]] | None = None


@dataclass(frozen=True, slots=True)
class Table(Block):
    """`gap` is of a terminal; `opens` is the summary of the rows' details."""

    columns: Sequence[Column]
    rows: Sequence[Row]
    caption: str = ""
    _: KW_ONLY
    label: str = ""
    gap: int = 1
    opens: str = ""

    def seen(self, medium: Medium) -> tuple[list[Column], list[tuple[Row, list[Words]]]]:
        """Return the columns of a medium, and its rows with their cells."""
        indices = [index for index, column in enumerate(self.columns) if medium in column.media]
        rows = [(row, [row.cells[index] for index in indices]) for row in self.rows if medium in row.media]
        return [self.columns[index] for index in indices], rows


@dataclass(frozen=True, slots=True)
class Fold(Block):
    summary: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Command(Block):
    device: str
    text: str


@dataclass(frozen=True, slots=True)
class Bars(Block):
    """In one line of a terminal if one of `short` fits."""

    rows: Sequence[tuple[str, float, str]]
    where: str
    short: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Fitted(Block):
    """What fits into `most` lines of a terminal."""

    parts: Sequence[Sequence[Block]]
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


def plain_text(words: Words) -> str:
    if isinstance(words, Figure):
        return words.text
    if isinstance(words, Stack):
        return "\n".join(span.text for span in words.spans)
    return words if isinstance(words, str) else "".join(span.text for span in words)


def stack(*spans: Span) -> Stack:
    return Stack([span for span in spans if span.text not in ("", MISSING)])


def visible(sections: Iterable[Section], medium: Medium) -> list[tuple[str, list[Block]]]:
    return [
        (section.name, blocks)
        for section in sections
        if medium in section.media and (blocks := [block for block in section.blocks if medium in block.media])
    ]
