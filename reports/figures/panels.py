"""Small multiples: panels of lines whose points are groups. Most figures are one of these with other axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..book.groups import groups_info

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from dds_trace.analyzer.analysis import Analysis

    from ..book.groups import Cell, Series


@dataclass(frozen=True, slots=True)
class Line:
    """One series in one panel.

    Attributes:
        series: index into `Groups.series`.
        x: ascending positions on the axis.
        groups: the group at each position.
    """

    series: int
    x: tuple[float, ...]
    groups: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes; lines by series."""

    title: str
    lines: tuple[Line, ...]


def panels_info(
    analysis: Analysis,
    key: Callable[[Cell, Series], Hashable],
    title: Callable[[Cell, Series], str],
    x: Callable[[Cell], float] | None = None,
    drawn: Callable[[int], bool] = lambda _: True,
) -> tuple[Panel, ...]:
    """All groups, spread over panels by `key` in the order of cells.

    Args:
        analysis: where the groups are from.
        key: groups of equal key share a panel.
        title: names a panel, by any of its groups.
        x: a group's position; the rank of its cell among all cells if not given.
        drawn: whether a group (its index) has what the figure draws; all are taken if not given.
    """
    groups = groups_info(analysis)
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


def panels_plan(panels: tuple[Panel, ...], **axes: Any) -> dict[str, Any]:
    """The panels beside the axes' settings."""
    return {"panels": panels, **axes}
