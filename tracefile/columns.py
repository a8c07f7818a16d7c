"""Columns that grow in place and end up holding exactly the events that came."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tracefile.event_scan import records_at
from tracefile.events import EVENT_DTYPE, EventColumns, Stage

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tracefile.event_scan import Index, Records

_FIELDS = EVENT_DTYPE.names or ()
_SMALLEST_GROWTH = 1 << 14


class ColumnsBuilder:
    """The events of all stages, each batch copied into its place.

    Args:
        expected: events that each stage may come to hold. Memory is reserved for them, and taken when they come.
    """

    def __init__(self, expected: Mapping[Stage, int]) -> None:
        self._columns = {stage: _reserve(expected.get(stage, 0)) for stage in Stage}
        self._filled = dict.fromkeys(Stage, 0)

    def append(self, stage: Stage, records: Records, index: Index) -> None:
        """Put the events at `index` of `records` behind those that the stage has."""
        start = self._filled[stage]
        end = start + len(index)
        if end > len(self._columns[stage]):
            self._columns[stage] = _grown(self._columns[stage], start, end)
        taken = records if len(index) == len(records) else records_at(records, index)
        for name in _FIELDS:
            getattr(self._columns[stage], name)[start:end] = taken[name]
        self._filled[stage] = end

    def finish(self) -> dict[Stage, EventColumns]:
        """All events; the builder is used up."""
        return {stage: _first(columns, self._filled[stage]) for stage, columns in self._columns.items()}


def columns_at(records: Records, index: Index) -> EventColumns:
    """The events at `index` of `records` as columns of their own."""
    return EventColumns.from_records(records_at(records, index))


def _reserve(count: int) -> EventColumns:
    """Columns of `count` events whose content is not set; where the memory cannot be had, empty ones.

    All lie in one piece of memory: numpy asks for large pages for it as a whole, and touching fresh memory, half of
    the time of filling it page by page, costs next to nothing. What is never filled is never taken from the system.
    """
    try:
        memory = np.empty(count * EVENT_DTYPE.itemsize, np.uint8)
    except MemoryError:
        return EventColumns.empty()
    columns: dict[str, np.ndarray[Any, Any]] = {}
    start = 0
    for name in _FIELDS:
        end = start + count * EVENT_DTYPE[name].itemsize
        columns[name] = memory[start:end].view(EVENT_DTYPE[name])
        start = end
    return EventColumns(**columns)


def _first(columns: EventColumns, count: int) -> EventColumns:
    """The first `count` events: views, and so without a copy."""
    if not count:
        return EventColumns.empty()  # which holds no memory back
    return EventColumns(**{name: getattr(columns, name)[:count] for name in _FIELDS})


def _grown(columns: EventColumns, filled: int, needed: int) -> EventColumns:
    """Columns with room for `needed` events and more; the first `filled` are kept."""
    larger = _reserve(max(needed, len(columns) * 5 // 4, _SMALLEST_GROWTH))
    if len(larger) < needed:
        raise MemoryError(f"no memory for columns of {needed} events")
    for name in _FIELDS:
        getattr(larger, name)[:filled] = getattr(columns, name)[:filled]
    return larger
