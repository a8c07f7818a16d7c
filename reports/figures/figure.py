"""How a figure is made: numbers from the book, then the plan that the page draws.

A plan names groups in place of values. The page looks the values up (metric, statistic and filters are the reader's
choice) and draws with plotly.js, so one plan serves every view and the page holds each number once.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, TypeVar

from ..book.groups import data_type_label

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Mapping

    from ..book.book import Book
    from ..book.groups import Cell, Groups, Series

Info = TypeVar("Info")


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that can be drawn.

    Attributes:
        name: id in the page and in file names of downloads.
        title: heading of the figure.
        how_to_read: one sentence for the reader.
        kind: function of `assets/kinds.js` that draws it.
        plan: arguments of that function, as `json_island` writes them.
    """

    name: str
    title: str
    how_to_read: str
    kind: str
    plan: Mapping[str, object]


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
    """One row of the table of figures (`reports.figures.FIGURES`)."""

    scope: Scope
    draw: Callable[[Book], Figure | LeftOut]


def figure_maker(
    info: Callable[[Book], Info],
    figure: Callable[[Info], Figure | LeftOut],
    scope: Scope = Scope.CAMPAIGN,
) -> FigureMaker:
    """Join the two steps of a figure into its row of the table.

    Args:
        info: numbers of the figure, from the book; what tests compare.
        figure: plan of the figure, from these numbers alone.
        scope: what one view shows.
    """
    return FigureMaker(scope, lambda book: figure(info(book)))


@dataclass(frozen=True, slots=True)
class Line:
    """One series in one panel.

    Attributes:
        series: index into `Groups.series`.
        x: ascending positions on the axis.
        groups: index of the group at each position.
    """

    series: int
    x: tuple[float, ...]
    groups: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes with its lines, by series."""

    title: str
    lines: tuple[Line, ...]


def panels_info(
    groups: Groups,
    key: Callable[[Cell, Series], Hashable],
    title: Callable[[Cell, Series], str],
    x: Callable[[Cell], float] | None = None,
    drawn: Callable[[int], bool] = lambda _: True,
) -> tuple[Panel, ...]:
    """Spread groups over panels, in the order of their cells.

    Args:
        groups: groups of the report.
        key: groups of equal key share a panel.
        title: heading of a panel, from the cell and series of its first group.
        x: position of a group; the rank of its cell among all cells by default.
        drawn: whether the group of this index has the values that the figure draws; all groups by default.
    """
    ordered = sorted(groups.groups, key=lambda group: (group.cell, group.series))
    titles: dict[Hashable, str] = {}
    points: dict[Hashable, dict[int, list[tuple[float, int]]]] = {}
    for group in filter(lambda group: drawn(group.index), ordered):
        cell, series = groups.cell_of(group), groups.series_of(group)
        panel = key(cell, series)
        at = float(group.cell) if x is None else x(cell)
        titles.setdefault(panel, title(cell, series))
        points.setdefault(panel, {}).setdefault(group.series, []).append((at, group.index))
    return tuple(
        Panel(
            titles[panel],
            tuple(
                Line(series, tuple(at for at, _ in sorted(line)), tuple(group for _, group in sorted(line)))
                for series, line in sorted(lines.items())
            ),
        )
        for panel, lines in points.items()
    )


def cell_panels(groups: Groups, drawn: Callable[[int], bool]) -> tuple[Panel, ...]:
    """Spread groups over panels by data type and domain mode; x is the rank of the cell among all cells."""

    def title(cell: Cell, series: Series) -> str:
        mode = "same domain" if series.domain_mode == "same" else "different domains"
        return f"{data_type_label(cell.data_type)}, {mode}"

    def key(cell: Cell, series: Series) -> tuple[str, str]:
        return cell.data_type, series.domain_mode

    return panels_info(groups, key, title, drawn=drawn)


def over_two_positions(panels: tuple[Panel, ...]) -> tuple[Panel, ...]:
    """Keep the panels whose points lie at two positions at least: one position makes no line."""
    return tuple(panel for panel in panels if len({x for line in panel.lines for x in line.x}) > 1)


def panels_plan(panels: tuple[Panel, ...], **settings: object) -> dict[str, object]:
    """Return the plan of a figure of panels: the panels beside the settings of its axes."""
    return {"panels": panels, **settings}
