"""Columns that are filled from several threads and end up holding exactly the events that came."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from tracefile.event_scan import records_at
from tracefile.events import EVENT_DTYPE, EventColumns, Stage

if TYPE_CHECKING:
    from collections.abc import Mapping
    from concurrent.futures import Executor, Future

    from tracefile.event_scan import Index, Records

_FIELDS = EVENT_DTYPE.names or ()
_TASKS_IN_FLIGHT = 8  # each holds a block of unpacked records
_SMALLEST_GROWTH = 1 << 16


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

    def append(self, stage: Stage, records: Records, index: Index) -> None:
        """Put the events at `index` behind those that the stage has."""
        start = self._filled[stage]
        end = start + len(index)
        columns = self._columns[stage]
        if end > len(columns["run_id"]):
            self._settle()
            _resize(columns, max(end, len(columns["run_id"]) * 5 // 4, _SMALLEST_GROWTH))
        self._filled[stage] = end
        self._in_flight.append(self._pool.submit(_fill, columns, start, records, index))
        while len(self._in_flight) > _TASKS_IN_FLIGHT:
            self._in_flight.popleft().result()

    def finish(self) -> dict[Stage, EventColumns]:
        """All events; the builder is used up."""
        self._settle()
        for stage, columns in self._columns.items():
            _resize(columns, self._filled[stage])
        return {stage: EventColumns(**columns) for stage, columns in self._columns.items()}

    def _settle(self) -> None:
        """Wait until nobody writes into the columns, which may then move."""
        while self._in_flight:
            self._in_flight.popleft().result()


def columns_at(records: Records, index: Index) -> EventColumns:
    """The events at `index` of `records` as columns of their own."""
    return EventColumns.from_records(records_at(records, index))


def _fill(columns: dict[str, np.ndarray[Any, Any]], start: int, records: Records, index: Index) -> None:
    taken = records if len(index) == len(records) else records_at(records, index)
    for name in _FIELDS:
        columns[name][start : start + len(index)] = taken[name]


def _reserve(count: int) -> dict[str, np.ndarray[Any, Any]]:
    """Columns of `count` events; where so much memory cannot be had, empty ones, which grow by what comes."""
    try:
        return {name: np.empty(count, EVENT_DTYPE[name]) for name in _FIELDS}
    except MemoryError:
        return _reserve(0)


def _resize(columns: dict[str, np.ndarray[Any, Any]], count: int) -> None:
    """Change the columns' length in place: memory is moved by the kernel, page by page, and never held twice."""
    for column in columns.values():
        column.resize(count, refcheck=False)
