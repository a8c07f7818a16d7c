"""Columns that are filled from several threads and end up holding exactly the events that came."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from tracefile.event_scan import records_at
from tracefile.events import EVENT_DTYPE, EventColumns, Stage

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from concurrent.futures import Executor, Future

    from tracefile.event_scan import Index, Records

_FIELDS = EVENT_DTYPE.names or ()
_TASKS_IN_FLIGHT = 8  # each holds a block of unpacked records
_SMALLEST_GROWTH = 1 << 14


class ColumnsBuilder:
    """The events of all stages, each batch copied into its place by `pool` while the next one is unpacked.

    Args:
        pool: where the copying is done.
        expected: events that each stage may come to hold. Memory is reserved for them, and taken when they come.
    """

    def __init__(self, pool: Executor, expected: Mapping[Stage, int]) -> None:
        self._pool = pool
        self._in_flight: deque[Future[None]] = deque()
        self._columns = {stage: _reserve(expected.get(stage, 0)) for stage in Stage}
        self._filled = dict.fromkeys(Stage, 0)

    def append(self, records: Records, groups: Sequence[tuple[Stage, Index]]) -> None:
        """Put the events of each group, which lie at its index in `records`, behind those that its stage has."""
        places: list[tuple[EventColumns, int, Index]] = []
        for stage, index in groups:
            start = self._filled[stage]
            end = start + len(index)
            if end > len(self._columns[stage]):
                self._settle()
                self._columns[stage] = _grown(self._columns[stage], start, end)
            self._filled[stage] = end
            places.append((self._columns[stage], start, index))
        self._in_flight.append(self._pool.submit(_fill, records, places))
        while len(self._in_flight) > _TASKS_IN_FLIGHT:
            self._in_flight.popleft().result()

    def finish(self) -> dict[Stage, EventColumns]:
        """All events; the builder is used up."""
        self._settle()
        return {stage: _first(columns, self._filled[stage]) for stage, columns in self._columns.items()}

    def _settle(self) -> None:
        """Wait until nobody writes into the columns, which may then be replaced."""
        while self._in_flight:
            self._in_flight.popleft().result()


def columns_at(records: Records, index: Index) -> EventColumns:
    """The events at `index` of `records` as columns of their own."""
    return EventColumns.from_records(records_at(records, index))


def _fill(records: Records, places: Sequence[tuple[EventColumns, int, Index]]) -> None:
    for columns, start, index in places:
        taken = records if len(index) == len(records) else records_at(records, index)
        for name in _FIELDS:
            getattr(columns, name)[start : start + len(index)] = taken[name]


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
