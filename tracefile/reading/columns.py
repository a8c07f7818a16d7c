"""Columns of events that grow in place, so that reading copies each event once."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from ..format.events import EVENT_DTYPE, EventColumns, Stage

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..format.event_record import Records

# An event is six fields of 8 bytes and then two of 4: two blocks of columns, each filled in one step.
_NAMES = EVENT_DTYPE.names or ()
_WIDE = tuple(name for name in _NAMES if EVENT_DTYPE[name].itemsize == 8)
_NARROW = _NAMES[len(_WIDE) :]
_WIDE_BYTES = 8 * len(_WIDE)
_SMALLEST_GROWTH = 1 << 14


class ColumnsBuilder:
    """Events of all stages, each batch copied into its place.

    Args:
        expected: number of events expected of each stage; memory is reserved for them, and taken when they come.
        most_events: events of all stages that make it full.
    """

    def __init__(self, expected: Mapping[Stage, int], most_events: int = sys.maxsize) -> None:
        self._columns = {stage: _StageColumns(min(most_events, expected.get(stage, 0))) for stage in Stage}
        self._most_events = most_events

    def is_full_before(self, events: int) -> bool:
        """Return whether so many more are too many; what is empty takes any number."""
        filled = sum(columns.filled for columns in self._columns.values())
        return filled > 0 and filled + events > self._most_events

    def append(self, stage: Stage, records: Records) -> None:
        """Append `records`, a contiguous array of `EVENT_DTYPE`, to the events of the stage."""
        self._columns[stage].append(records)

    def finish(self) -> dict[Stage, EventColumns]:
        """Return all events; the builder may not be used again."""
        return {stage: columns.finish() for stage, columns in self._columns.items()}


class _StageColumns:
    """Events of one stage.

    All columns lie in one piece of memory. numpy asks for large pages for it as a whole, so that touching fresh
    memory, half of the time of filling it page by page, costs next to nothing. Memory that is never filled is never
    taken from the system.

    Attributes:
        filled: number of events.
    """

    def __init__(self, expected: int) -> None:
        self.filled = 0
        try:
            self._reserve(expected)
        except (
            MemoryError
        ):  # the number is a claim of the file and may be wrong; the columns grow as events come
            self._reserve(0)

    def append(self, records: Records) -> None:
        start, end = self.filled, self.filled + len(records)
        if end > self._wide.shape[1]:
            wide, narrow = self._wide[:, :start], self._narrow[:, :start]
            self._reserve(max(end, self._wide.shape[1] * 5 // 4, _SMALLEST_GROWTH))
            self._wide[:, :start], self._narrow[:, :start] = wide, narrow
        count, step = len(records), EVENT_DTYPE.itemsize
        self._wide[:, start:end] = np.ndarray((len(_WIDE), count), "<i8", records, 0, (8, step))
        self._narrow[:, start:end] = np.ndarray((len(_NARROW), count), "<u4", records, _WIDE_BYTES, (4, step))
        self.filled = end

    def finish(self) -> EventColumns:
        """Return views of the filled part, so that nothing is copied; a stage without events keeps no memory."""
        if not self.filled:
            return EventColumns.empty()
        rows = zip(_NAMES, [*self._wide, *self._narrow], strict=True)
        return EventColumns(**{name: row[: self.filled].view(EVENT_DTYPE[name]) for name, row in rows})

    def _reserve(self, count: int) -> None:
        memory = np.empty(count * EVENT_DTYPE.itemsize, np.uint8)
        split = count * _WIDE_BYTES
        self._wide = memory[:split].view("<i8").reshape(len(_WIDE), count)
        self._narrow = memory[split:].view("<u4").reshape(len(_NARROW), count)
