"""How a figure is made: its plan from the book, which the page draws.

A plan has groups in place of values: the page looks them up, as metric, statistic and filters are the reader's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TypeAlias

from ..book.book import Book
from ..book.facets import MADE_OF
from ..book.groups import Group

Test = Callable[[int], bool]
"""Whether a group has what a figure draws."""

Plan: TypeAlias = "Mapping[str, object]"


class Scope(Enum):
    CAMPAIGN = "campaign"
    CELL = "cell"
    """The groups of one message, which the reader selects."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure(ABC):
    """A row of the table of figures: what each says of itself, and its plan, None where there is `nothing` to draw."""

    name: str
    title: str
    how_to_read: str
    nothing: str
    kind: str = "lines"
    scope: Scope = Scope.CAMPAIGN
    opened: bool = False
    few: bool = False
    follows: bool = False

    @abstractmethod
    def plan(self, book: Book) -> Plan | None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureMaker(Figure):
    make: Callable[[Book], Plan | None]
    opened: bool = True
    few: bool = True

    def plan(self, book: Book) -> Plan | None:
        return self.make(book)


FEW_GROUPS = 12
"""Most groups of the chart of dots; other figures would have a dot or two each."""


def is_few(book: Book) -> bool:
    return 0 < len(book.groups.groups) <= FEW_GROUPS


AXIS_TITLES = {"size": "Message size", "rate": "Rate (Hz)", "load": "Offered load"}

MOST_LINES = 7
"""Most lines of one panel; one with more becomes several."""

ATOMS = ("device", "link", "data", "vendor", "way", "rest", "size", "rate")
"""Dimensions that are made of no other, in the order of rows of panels."""


@dataclass(frozen=True, slots=True)
class Facet:
    """How groups are spread along the axis, over lines and over panels; what is on neither separates panels, as in `facets.js`.

    `x` is `size` in bytes, `rate` in Hz, `load` (their product), `plane` (rank of the message), `cell` (without) or another
    dimension of `book.facets`, as `lines` (empty: one a panel) and `panels`, whose values are side by side.
    """

    x: str
    panels: str
    lines: str = "choice"


@dataclass(frozen=True, slots=True)
class Line:
    """One line of one panel; `line` is the index of its option, `x` are ascending positions."""

    line: int
    x: tuple[float, ...]
    groups: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes with its lines, at most `MOST_LINES`; `part` counts panels that have the rest of them."""

    title: str
    lines: tuple[Line, ...]
    part: int = 1


@dataclass(frozen=True, slots=True)
class Faceted:
    """Groups of a figure, spread over panels; none where there is nothing to draw."""

    facet: Facet
    panels: tuple[Panel, ...]


def plane_facet(book: Book, panels: str = "choice", lines: str = "") -> Facet:
    return Facet("cell" if is_few(book) else "plane", panels, lines)


def facet_panels(book: Book, facet: Facet, drawn: Test = lambda _: True, least: int = 1) -> tuple[Panel, ...]:
    facets, groups = book.facets, book.groups
    columns, rows = panel_keys(facet)
    points: dict[tuple[int, ...], dict[int, list[tuple[float, int]]]] = {}
    for group in groups.in_order:
        if drawn(group.index):
            panel = tuple(facets.option(key, group.index) for key in (*rows, *columns))
            line = facets.option(facet.lines, group.index) if facet.lines else 0
            at = _position(book, facet.x, group)
            points.setdefault(panel, {}).setdefault(line, []).append((at, group.index))
    panels = []
    for _, lines in sorted(points.items()):
        if len({at for line in lines.values() for at, _ in line}) < least:
            continue
        (_, first), *_ = next(iter(lines.values()))
        names = [facets.label(key, first) for key in (*columns, *rows) if facets.varies(key)]
        title = ", ".join(filter(None, names)) or facets.label("data", first)
        drawn_lines = [Line(line, *map(tuple, zip(*sorted(own), strict=True))) for line, own in sorted(lines.items())]
        parts = -(-len(drawn_lines) // MOST_LINES)
        most = -(-len(drawn_lines) // parts)
        for part in range(parts):
            ending = f" ({part + 1} of {parts})" if parts > 1 else ""
            panels.append(Panel(f"{title}{ending}", tuple(drawn_lines[part * most : (part + 1) * most]), part + 1))
    return tuple(panels)


def panel_keys(facet: Facet) -> tuple[list[str], list[str]]:
    used = {*_atoms(facet.x), *_atoms(facet.lines)}
    columns = [key for key in _atoms(facet.panels) if key not in used]
    if "size" in columns and "data" not in used:
        columns.insert(0, "data")
    return columns, [key for key in ATOMS if key not in used and key not in columns]


def _atoms(key: str) -> tuple[str, ...]:
    return MADE_OF.get(key, (key,) if key else ())


def _position(book: Book, x: str, group: Group) -> float:
    cell = book.groups.cell_of(group)
    rate_hz = cell.rate_hz or book.values.plain["achieved_rate_hz"][group.index] or 1.0
    positions = {
        "size": float(cell.payload_bytes),
        "rate": rate_hz,
        "load": cell.payload_bytes * rate_hz,
        "plane": float(group.cell),
        "cell": float(group.cell),
    }
    return positions[x] if x in positions else float(book.facets.option(x, group.index))


def spread_plan(book: Book, facet: Facet, drawn: Test, **settings: object) -> Plan | None:
    groups = [group.index for group in book.groups.groups if drawn(group.index)]
    return {"facet": facet, "groups": groups, **settings} if groups else None


@dataclass(frozen=True, slots=True, kw_only=True)
class LineFigure(Figure):
    """Marks show `value`, a key of `VALUES` of the page's scripts and of `reports.plotting`."""

    x: str
    panels: str
    value: str
    label: str = ""
    drawn: Callable[[Book], Test]
    shows: Callable[[Book], Test] = lambda _: lambda _: True
    least: int = 1
    settings: Mapping[str, object] = field(default_factory=dict)

    def info(self, book: Book, panels: str = "", lines: str = "choice") -> Faceted:
        facet = Facet(self.x, panels or self.panels, lines)
        shows = self.shows(book)
        shown = (
            panel
            for panel in facet_panels(book, facet, self.drawn(book), self.least)
            if any(shows(group) for line in panel.lines for group in line.groups)
        )
        return Faceted(facet, tuple(shown))

    def plan(self, book: Book) -> Plan | None:
        info = self.info(book)
        groups = {group for panel in info.panels for line in panel.lines for group in line.groups}
        return spread_plan(book, info.facet, groups.__contains__, value=self.value, label=self.label, **self.settings)
