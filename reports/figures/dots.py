"""A few groups in one chart: each a line with its time, the interval and what was received."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..book.book import Book
from .bridge_cost import BridgedCell, bridge_cost_info
from .figure import FEW_GROUPS, Figure, FigureMaker, LeftOut, is_few


@dataclass(frozen=True, slots=True)
class Dots:
    """Groups from the top of the chart, and group through a bridge -> what that costs."""

    groups: tuple[int, ...]
    cells: Mapping[int, BridgedCell]


def dots_info(book: Book) -> Dots:
    groups = book.groups.in_order
    if not is_few(book) or not any(book.values.timed(group.index) for group in groups):
        return Dots((), {})
    return Dots(tuple(group.index for group in groups if group.published), bridge_cost_info(book).cells)


def dots_figure(info: Dots) -> Figure | LeftOut:
    name, title = "dots", "Latency at a glance"
    if not info.groups:
        return LeftOut(name, title, f"no message was received, or there are more than {FEW_GROUPS} results.")
    how_to_read = (
        "Each line is one result: the dot is its time with the 95 % interval, followed by the share received and how many times as long a "
        "message takes through a bridge as in the same domain; times are of the received messages."
    )
    cells = {str(group): cell for group, cell in info.cells.items()}
    return Figure(name, title, how_to_read, "dots", {"groups": info.groups, "cells": cells}, follows=True)


FIGURE = FigureMaker(dots_info, dots_figure)
