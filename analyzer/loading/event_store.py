"""Events in a file of our own: the columns of each stage, run and relay, read back one part at a time.

A column that is one value throughout (run, relay, payload size), or that counts upwards by one (sequence numbers of
a whole run), is kept as that; the others as they are in memory. That is a third of the bytes of the events.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dds_trace.tracefile import EVENT_DTYPE, EventColumns
from dds_trace.tracefile.files import open_regular, replacing

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path
    from typing import BinaryIO, TypeVar

    from numpy.typing import NDArray

    Label = TypeVar("Label")
    Column = tuple[str, int]
    """How a column is kept (`constant`, `counting`, `array`), and its value, first value, or offset in the file."""

_FIELDS = EVENT_DTYPE.names or ()

_KEPT: Mapping[str, Callable[[np.dtype[Any], int, int], tuple[int, int]]] = {
    "constant": lambda dtype, _count, _file_bytes: (np.iinfo(dtype).min, np.iinfo(dtype).max),
    "counting": lambda dtype, count, _file_bytes: (np.iinfo(dtype).min, np.iinfo(dtype).max - count + 1),
    "array": lambda dtype, count, file_bytes: (0, file_bytes - count * dtype.itemsize),
}
"""How a column is kept -> function of its dtype, the number of events and the bytes of the file that returns the least and
the greatest value (or offset in the file) that it may have."""


@dataclass(frozen=True, slots=True)
class StoredEvents:
    """The place in a file of the events of one stage, run and relay.

    Attributes:
        file: the file.
        count: number of events.
        columns: field of the event -> how and where it is kept.
    """

    file: Path
    count: int
    columns: Mapping[str, Column]

    def check(self, file_bytes: int) -> None:
        """Check that the file has room for every column, and that every value fits its column.

        Args:
            file_bytes: size of the file.

        Raises:
            ValueError, TypeError, LookupError: a column is not as `write_events` describes it.
        """
        if type(self.count) is not int or self.count <= 0:  # True is an int
            raise ValueError(f"{self.count!r} events")
        for name in _FIELDS:
            how, value = self.columns[name]
            if type(value) is not int:
                raise TypeError(f"{name} is kept at {value!r}")
            dtype = EVENT_DTYPE[name]
            low, high = _KEPT[how](dtype, self.count, file_bytes)
            if not low <= value <= high:
                raise ValueError(f"{name} is kept as {how} {value}, which is not from {low} to {high}")

    def arrays(self, events: EventColumns) -> list[NDArray[np.integer]]:
        """Return the columns of these events that are in the file; `columns` says all of the others."""
        return [getattr(events, name) for name in _FIELDS if self.columns[name][0] == "array"]

    def load(self) -> EventColumns:
        """Read the events.

        Raises:
            OSError: the file cannot be read, or has become shorter.
        """
        with open_regular(self.file, follow_links=False) as stream:
            return EventColumns(
                **{
                    name: _read_column(stream, EVENT_DTYPE[name], self.count, *self.columns[name])
                    for name in _FIELDS
                }
            )


def write_events(path: Path, parts: Mapping[Label, EventColumns]) -> dict[Label, StoredEvents]:
    """Write the events of `parts` into one file, which replaces `path` once it is complete.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as draft, draft.open("wb") as stream:
        return {
            label: StoredEvents(
                path, len(columns), {name: _write_column(stream, getattr(columns, name)) for name in _FIELDS}
            )
            for label, columns in parts.items()
        }


def _write_column(stream: BinaryIO, values: NDArray[np.integer]) -> Column:
    first, last = int(values[0]), int(values[-1])  # which tell of most columns that they are neither
    if first == last and (values == values[0]).all():
        return "constant", first
    if last - first == len(values) - 1 and (np.diff(values) == 1).all():
        return "counting", first
    offset = stream.tell()
    stream.write(np.ascontiguousarray(values).data)
    return "array", offset


def _read_column(
    stream: BinaryIO, dtype: np.dtype[np.integer], count: int, how: str, value: int
) -> NDArray[Any]:
    if how == "constant":
        return np.broadcast_to(np.array(value, dtype), count)  # takes no memory
    if how == "counting":
        return np.arange(count, dtype=dtype) + np.array(value, dtype)
    stream.seek(value)
    values = np.fromfile(stream, dtype, count)
    if len(values) < count:
        raise OSError(5, f"{stream.name} is shorter than it was written")
    return values
