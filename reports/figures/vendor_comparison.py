"""The paper's comparison of vendors for Binary, String and IMU, in the same and in different domains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..book.groups import data_type_label
from .figure import Figure, LeftOut, Panel, figure_maker, panels_info, panels_plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..book.book import Book
    from ..book.groups import Cell, Groups, Series

NAME = "vendor_comparison"
TITLE = "Vendors against each other, per data type"
HOW_TO_READ = (
    "Marks above one another sent the same messages: the lowest was fastest there, and every mark of the campaign "
    "is in this figure."
)


@dataclass(frozen=True, slots=True)
class VendorComparison:
    """One panel per data type and domain mode; x is the rank of the cell in `Groups.cells`."""

    panels: tuple[Panel, ...]


def vendor_comparison_info(book: Book) -> VendorComparison:
    """Every group, over its cell."""
    return VendorComparison(cell_panels(book.groups, book.values.timed))


def vendor_comparison_figure(info: VendorComparison) -> Figure | LeftOut:
    """Marks over cells: sizes, and within each size the rates."""
    if not info.panels:
        return LeftOut(NAME, TITLE, "no message came back.")
    return Figure(NAME, TITLE, HOW_TO_READ, "cells", panels_plan(info.panels, value="statistic"))


FIGURE = figure_maker(vendor_comparison_info, vendor_comparison_figure)


def cell_panels(groups: Groups, drawn: Callable[[int], bool]) -> tuple[Panel, ...]:
    """One panel per data type and domain mode; x is the rank of the cell among all cells."""

    def title(cell: Cell, series: Series) -> str:
        mode = "same domain" if series.domain_mode == "same" else "different domains"
        return f"{data_type_label(cell.data_type)}, {mode}"

    def key(cell: Cell, series: Series) -> tuple[str, str]:
        return cell.data_type, series.domain_mode

    return panels_info(groups, key, title, drawn=drawn)
