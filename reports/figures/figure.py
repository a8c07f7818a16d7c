"""How a figure is made: numbers from the book, then the plan that the page draws.

A plan names groups in place of values. The page looks the values up (metric, statistic and filters are the reader's
choice) and draws with plotly.js, so one plan serves every view and the page holds each number once.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, TypeVar

from ..book.facets import MADE_OF

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ..book.book import Book
    from ..book.groups import Group

Info = TypeVar("Info")


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that can be drawn.

    Attributes:
        name: id in the page and in file names of downloads.
        title: heading of the figure.
        how_to_read: one sentence for the reader.
        kind: function of the page's scripts (`KINDS`) that draws it.
        plan: arguments of that function, as `json_island` writes them.
        follows: whether the reader's metric and statistic are what it shows, so that title and file name say them; the
            word Latency at the title's beginning gives way to the metric.
    """

    name: str
    title: str
    how_to_read: str
    kind: str
    plan: Mapping[str, object]
    follows: bool = False


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A figure without data, and the sentence that says why."""

    name: str
    title: str
    reason: str


class Scope(Enum):
    """What one view of a figure shows."""

    CAMPAIGN = "campaign"
    """Every group that passes the page's filters."""
    CELL = "cell"
    """The groups of one cell (data type, size, rate), which the reader picks."""


@dataclass(frozen=True, slots=True)
class FigureMaker:
    """One row of the table of figures (`reports.figures.FIGURES`).

    Attributes:
        scope: what one view shows.
        draw: the figure of a book, or why there is none.
        opened: whether the page shows it at once; any other is a line that opens it.
        few: whether it says more of a few groups than the chart of dots (`FEW_GROUPS`), which stands in for the
            others then.
    """

    scope: Scope
    draw: Callable[[Book], Figure | LeftOut]
    opened: bool
    few: bool


def figure_maker(
    info: Callable[[Book], Info],
    figure: Callable[[Info], Figure | LeftOut],
    scope: Scope = Scope.CAMPAIGN,
    *,
    opened: bool = True,
    few: bool = True,
) -> FigureMaker:
    """Join the two steps of a figure into its row of the table.

    Args:
        info: numbers of the figure, from the book; what tests compare.
        figure: plan of the figure, from these numbers alone.
        scope: what one view shows.
        opened: whether the page shows it at once.
        few: whether it is drawn of a few groups, too.
    """
    return FigureMaker(scope, lambda book: figure(info(book)), opened, few)


FEW_GROUPS = 12
"""Most groups that the chart of dots shows. Of so few, figures with an axis of sizes or rates have a dot or two each."""


def is_few(book: Book) -> bool:
    """Whether the chart of dots stands in for figures that need more groups."""
    return 0 < len(book.groups.groups) <= FEW_GROUPS


MOST_LINES = 7
"""Most lines of one panel: more cannot be told apart, so that such a panel becomes several."""

_ATOMS = ("device", "link", "data", "vendor", "way", "rest", "size", "rate")
"""Dimensions that are made of no other, in the order in which rows of panels follow one another."""


@dataclass(frozen=True, slots=True)
class Facet:
    """How groups are spread: along the axis, over lines, and over panels beside and below one another.

    What is neither on the axis nor a line sets panels apart. The page spreads in the same way (`facets.js`).

    Attributes:
        x: `size` in bytes, `rate` in Hz, `load` (their product), `plane` (rank of the cell, each data type in panels of its own),
            `cell` (the same for all data types) or another dimension of `book.facets` (place of the option).
        panels: dimension whose values stand side by side; the others follow below.
        lines: dimension with a line for each value; empty for one line a panel.
    """

    x: str
    panels: str
    lines: str = "choice"


@dataclass(frozen=True, slots=True)
class Line:
    """One line of one panel.

    Attributes:
        line: place of its value among the options of the dimension of lines; 0 where there is none.
        x: ascending positions on the axis.
        groups: index of the group at each position.
    """

    line: int
    x: tuple[float, ...]
    groups: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes with its lines, at most `MOST_LINES`."""

    title: str
    lines: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class Faceted:
    """Groups of a figure, spread over panels; `facet` says how."""

    facet: Facet
    panels: tuple[Panel, ...]


def faceted(book: Book, facet: Facet, drawn: Callable[[int], bool] = lambda _: True) -> Faceted:
    """Spread groups as `facet_panels` does."""
    return Faceted(facet, facet_panels(book, facet, drawn))


def faceted_lines(book: Book, facet: Facet, drawn: Callable[[int], bool] = lambda _: True) -> Faceted:
    """Spread groups over the panels that have two positions at least."""
    return Faceted(facet, over_two_positions(facet_panels(book, facet, drawn)))


def facet_panels(
    book: Book, facet: Facet, drawn: Callable[[int], bool] = lambda _: True
) -> tuple[Panel, ...]:
    """Spread groups over panels and lines.

    Args:
        book: groups of the report and their dimensions.
        facet: what is spread along what.
        drawn: whether the group of this index has the values that the figure draws; all groups by default.
    """
    facets, groups = book.facets, book.groups
    columns, rows = panel_keys(facet)
    points: dict[tuple[int, ...], dict[int, list[tuple[float, int]]]] = {}
    for group in sorted(groups.groups, key=lambda group: (group.cell, group.series)):
        if not drawn(group.index):
            continue
        panel = tuple(facets.option(key, group.index) for key in (*rows, *columns))
        line = facets.option(facet.lines, group.index) if facet.lines else 0
        at = _position(book, facet.x, group)
        points.setdefault(panel, {}).setdefault(line, []).append((at, group.index))
    panels = []
    for _, lines in sorted(points.items()):
        (_, first), *_ = next(iter(lines.values()))
        told = [facets.label(key, first) for key in (*columns, *rows) if facets.varies(key)]
        title = ", ".join(label for label in told if label) or facets.label("data", first)
        made = [
            Line(line, tuple(at for at, _ in sorted(own)), tuple(group for _, group in sorted(own)))
            for line, own in sorted(lines.items())
        ]
        parts = -(-len(made) // MOST_LINES)
        most = -(-len(made) // parts)
        for part in range(parts):
            ending = f" ({part + 1} of {parts})" if parts > 1 else ""
            panels.append(Panel(f"{title}{ending}", tuple(made[part * most : (part + 1) * most])))
    return tuple(panels)


def panel_keys(facet: Facet) -> tuple[list[str], list[str]]:
    """Return the dimensions that set panels apart: side by side, and below one another."""
    used = {*_atoms(facet.x), *_atoms(facet.lines)}
    columns = [key for key in _atoms(facet.panels) if key not in used]
    if "size" in columns and "data" not in used:
        columns.insert(0, "data")
    return columns, [key for key in _ATOMS if key not in used and key not in columns]


def _atoms(key: str) -> tuple[str, ...]:
    return MADE_OF.get(key, (key,) if key else ())


def _position(book: Book, x: str, group: Group) -> float:
    cell = book.groups.cell_of(group)
    known = {
        "size": float(cell.payload_bytes),
        "rate": cell.rate_hz,
        "load": cell.payload_bytes * cell.rate_hz,
        "plane": float(group.cell),
        "cell": float(group.cell),
    }
    return known[x] if x in known else float(book.facets.option(x, group.index))


def over_two_positions(panels: tuple[Panel, ...]) -> tuple[Panel, ...]:
    """Keep the panels whose points lie at two positions at least: one position makes no line."""
    return tuple(panel for panel in panels if len({x for line in panel.lines for x in line.x}) > 1)


def facet_plan(facet: Facet, panels: tuple[Panel, ...], **settings: object) -> dict[str, object]:
    """Return the plan of a figure of panels: how it is spread and its groups, beside the settings of its axes."""
    groups = sorted(group for panel in panels for line in panel.lines for group in line.groups)
    return {"facet": facet, "groups": groups, **settings}
