"""Events in a file of our own: the columns of each stage, run and relay, written piece by piece.

A column of one value, or that counts up by one (sequence numbers), is described; others are written as they are in
memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dds_trace.base.files import open_regular, read_into
from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from io import BufferedReader
    from pathlib import Path

    from numpy.typing import NDArray


Column = tuple[str, int]
"""Kind (`constant`, `counting`, `array`), and value, first value, or offset in the file."""


_FIELDS = EVENT_DTYPE.names or ()

_LIMITS: Mapping[str, Callable[[np.dtype[Any], int, int], tuple[int, int]]] = {
    "constant": lambda dtype, _count, _file_bytes: (np.iinfo(dtype).min, np.iinfo(dtype).max),
    "counting": lambda dtype, count, _file_bytes: (np.iinfo(dtype).min, np.iinfo(dtype).max - count + 1),
    "array": lambda dtype, count, file_bytes: (0, file_bytes - count * dtype.itemsize),
}
"""Kind -> function of dtype, number of events and bytes of the file that returns the least and greatest valid value."""


@dataclass(frozen=True, slots=True)
class StoredPiece:
    """Events written together: field of the event -> its column."""

    count: int
    columns: Mapping[str, Column]

    def check(self, file_bytes: int) -> None:
        """Check that a file of this size has room for every column, and that every value fits its column.

        Raises:
            ValueError, TypeError, LookupError: a column is not as `EventsFile` describes it.
        """
        if type(self.count) is not int or self.count <= 0:  # True is an int
            raise ValueError(f"{self.count!r} events")
        for name in _FIELDS:
            kind, value = self.columns[name]
            if type(value) is not int:
                raise TypeError(f"{name} has {value!r}")
            dtype = EVENT_DTYPE[name]
            low, high = _LIMITS[kind](dtype, self.count, file_bytes)
            if not low <= value <= high:
                raise ValueError(f"{name} is {kind} {value}, which is not from {low} to {high}")

    def arrays(self, events: EventColumns, first: int = 0) -> list[NDArray[np.integer]]:
        return [
            getattr(events, name)[first : first + self.count] for name in _FIELDS if self.columns[name][0] == "array"
        ]


@dataclass(frozen=True, slots=True)
class StoredEvents:
    """Where the events of one stage, run and relay are in a file."""

    file: Path
    pieces: tuple[StoredPiece, ...]

    @property
    def count(self) -> int:
        return sum(piece.count for piece in self.pieces)

    def check(self, file_bytes: int) -> None:
        if not self.pieces:
            raise ValueError("no events")
        for piece in self.pieces:
            piece.check(file_bytes)

    def arrays(self, events: EventColumns) -> list[NDArray[np.integer]]:
        firsts = accumulate((piece.count for piece in self.pieces), initial=0)
        return [
            array for piece, first in zip(self.pieces, firsts, strict=False) for array in piece.arrays(events, first)
        ]

    def load(self) -> EventColumns:
        """Read the events.

        Raises:
            OSError: the file cannot be read, or has become shorter.
        """
        with open_regular(self.file, follow_links=False) as stream:
            return EventColumns(**{name: _read_column(stream, name, self.pieces) for name in _FIELDS})


class EventsFile:
    """Writes events into a stream."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def write(self, events: EventColumns) -> StoredPiece:
        columns = {name: self._write_column(getattr(events, name)) for name in _FIELDS}
        return StoredPiece(len(events), columns)

    def _write_column(self, values: NDArray[np.integer]) -> Column:
        first, last = int(values[0]), int(values[-1])  # rule out both kinds for most columns
        if first == last and (values == values[0]).all():
            return "constant", first
        if last - first == len(values) - 1 and (np.diff(values) == 1).all():
            return "counting", first
        offset = self._stream.tell()
        self._stream.write(np.ascontiguousarray(values).data)
        return "array", offset


def _read_column(stream: BufferedReader, name: str, pieces: Sequence[StoredPiece]) -> NDArray[Any]:
    dtype = EVENT_DTYPE[name]
    count = sum(piece.count for piece in pieces)
    columns = {piece.columns[name] for piece in pieces}
    if len(columns) == 1 and pieces[0].columns[name][0] == "constant":
        return np.broadcast_to(np.array(pieces[0].columns[name][1], dtype), count)
    values = np.empty(count, dtype)
    start = 0
    for piece in pieces:
        kind, value = piece.columns[name]
        part = values[start : start + piece.count]
        start += piece.count
        if kind == "constant":
            part[:] = value
        elif kind == "counting":
            part[:] = np.arange(piece.count, dtype=dtype)
            part += np.array(value, dtype)
        else:
            room = part.data.cast("B")
            if read_into(stream.fileno(), room, value) < len(room):
                raise OSError(5, f"{stream.name} is shorter than it was written")
    return values
