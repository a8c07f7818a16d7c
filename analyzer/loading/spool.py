"""Events in temporary files until they are paired, written piece by piece.

A column of one value, or that counts up by one (sequence numbers), is described; others are written as they are in
memory.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.files import open_regular, read_into
from dds_trace.tracefile.format.events import EVENT_DTYPE, EventColumns

Column = tuple[str, int]
"""Kind (`constant`, `counting`, `array`), and value, first value, or offset in the file."""

_FIELDS = EVENT_DTYPE.names or ()


class TemporaryFolder:
    """A folder of this user only, which is removed with this object."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="dds-analyze-"))
        self.remove = weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@dataclass(frozen=True, slots=True)
class SpooledPiece:
    """Events written together: field of the event -> its column."""

    count: int
    columns: Mapping[str, Column]


@dataclass(frozen=True, slots=True)
class SpooledEvents:
    file: Path
    pieces: tuple[SpooledPiece, ...]

    @property
    def count(self) -> int:
        return sum(piece.count for piece in self.pieces)

    def load(self) -> EventColumns:
        """Read the events; an `OSError` if the file cannot be read, or has become shorter."""
        with open_regular(self.file, follow_links=False) as stream:
            return EventColumns(**{name: _read_column(stream, name, self.pieces) for name in _FIELDS})


def write_events(stream: BinaryIO, events: EventColumns) -> SpooledPiece:
    return SpooledPiece(len(events), {name: _write_column(stream, getattr(events, name)) for name in _FIELDS})


def _write_column(stream: BinaryIO, values: NDArray[np.integer]) -> Column:
    first, last = int(values[0]), int(values[-1])  # rule out both kinds for most columns
    if first == last and (values == values[0]).all():
        return "constant", first
    if last - first == len(values) - 1 and (np.diff(values) == 1).all():
        return "counting", first
    offset = stream.tell()
    stream.write(np.ascontiguousarray(values).data)
    return "array", offset


def _read_column(stream: BufferedReader, name: str, pieces: Sequence[SpooledPiece]) -> NDArray[Any]:
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
