"""The picture next to the answer: a dot with its interval for each setup."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from .facets import Facets
from .numbers import Intervals
from .sizes import PlaceRows, SizeCell, SizeRow, SizeTable

MOST_BLOCKS, MOST_ROWS, MOST_LINKS = 6, 18, 4


@dataclass(frozen=True, slots=True)
class Dot:
    """One median: `cell` has it as text, the others are percent of the width."""

    cell: SizeCell
    at: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class DotRow:
    """`choice` is the setup's option among the dimension's, None where it has no group."""

    setup: str
    choice: int | None
    dots: tuple[Dot | None, ...]


@dataclass(frozen=True, slots=True)
class Glance:
    """Blocks of rows, by device pair or by size; `left_out` counts blocks that only the table has."""

    message: str
    columns: tuple[str, ...]
    blocks: tuple[tuple[str, tuple[DotRow, ...]], ...]
    left_out: int


def glance_info(table: SizeTable | None, intervals: Intervals, facets: Facets) -> Glance | None:
    if table is None:
        return None
    blocks: dict[str, dict[str, SizeRow]]
    if len(table.places) > 1:
        counts = Counter((row.size, row.rate) for site in table.places for row in site.rows)
        alike = [message for message, count in counts.items() if count == max(counts.values())]
        size, rate = alike[(len(alike) - 1) // 2]
        blocks = _by_place(table.places, size, rate)
        message = f"{size} at {rate}"
    else:
        blocks = {row.size: {"": row} for site in table.places for row in site.rows}
        message = table.rates
    most = max(1, min(MOST_BLOCKS, MOST_ROWS // len(table.choices)))
    last = len(blocks) - 1
    chosen = {round(index * last / max(1, most - 1)) for index in range(most)} if last >= most else range(last + 1)
    shown = {name: rows for index, (name, rows) in enumerate(blocks.items()) if index in chosen}
    columns = tuple(dict.fromkeys(link for rows in shown.values() for link in rows))
    reached = [
        ns
        for rows in shown.values()
        for row in rows.values()
        for cell in row.cells
        if cell
        for ns in _ends(cell, intervals)
    ]
    if not reached or len(columns) > MOST_LINKS:  # in more columns texts overlap
        return None
    low, high = math.log(min(reached)), math.log(max(reached))

    def percent(ns: float) -> float:
        return round(2 + 96 * (math.log(ns) - low) / (high - low or 1), 1)

    def dot(cell: SizeCell | None) -> Dot | None:
        if cell is None:
            return None
        ends = _ends(cell, intervals)
        return Dot(cell, *map(percent, ends)) if ends else Dot(cell, None, 0.0, 0.0)

    blocks_drawn = []
    for name, rows in shown.items():
        dots = []
        for column, setup in enumerate(table.choices):
            cells = [rows[link].cells[column] if link in rows else None for link in columns]
            groups = [cell.group for cell in cells if cell and cell.group is not None]
            if any(cells):
                choice = facets.option("choice", groups[0]) if groups else None
                dots.append(DotRow(setup, choice, tuple(map(dot, cells))))
        blocks_drawn.append((name, tuple(dots)))
    return Glance(message, columns, tuple(blocks_drawn), len(blocks) - len(shown))


def _by_place(places: Sequence[PlaceRows], size: str, rate: str) -> dict[str, dict[str, SizeRow]]:
    blocks: dict[str, dict[str, SizeRow]] = {}
    for site in places:
        for row in site.rows:
            if (row.size, row.rate) == (size, rate):
                blocks.setdefault(site.devices, {})[site.link] = row
    return blocks


def _ends(cell: SizeCell, intervals: Intervals) -> tuple[float, ...]:
    at = cell.p50_ns
    if at is None or not math.isfinite(at) or at <= 0:
        return ()
    low, high = (None, None) if cell.group is None else intervals.ends("latency", "p50", cell.group)
    return at, min(low or at, at), max(high or at, at)
