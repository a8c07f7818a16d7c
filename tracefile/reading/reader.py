"""A trace read back: all of it, piece by piece, or batch by batch."""

from __future__ import annotations

import os
import sys
import weakref
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..format.events import EVENT_DTYPE, MOST_STAMP_NS, EventColumns, Records, Stage
from .storage import open_source, storage_files
from .trace import Trace, TraceBuilder, ring_beside

# Six fields of 8 bytes and then two of 4: two blocks of columns, each filled in one step.
_NAMES = EVENT_DTYPE.names or ()
_WIDE = tuple(name for name in _NAMES if EVENT_DTYPE[name].itemsize == 8)
_NARROW = _NAMES[len(_WIDE) :]
_WIDE_BYTES = 8 * len(_WIDE)
_SMALLEST_GROWTH = 1 << 14
_INSTANTS, _OPTIONAL = slice(2, 4), slice(4, 6)  # of the wide columns: T and T0; the middleware's stamps


class ColumnsMemory:
    """Memory for columns, reused as soon as nobody refers to a column in it."""

    def __init__(self) -> None:
        self._free: list[NDArray[np.uint8]] = []  # any thread that drops the last column appends

    def lend(self, size: int) -> NDArray[np.uint8]:
        """Return memory, not cleared; it comes back with the last array that is a view of it."""
        if not size:
            return np.empty(0, np.uint8)
        owner = self._free.pop() if self._free else None
        if owner is None or len(owner) < size:
            owner = np.empty(size, np.uint8)
        # Through its buffer: views refer to `lent` and not to the owner.
        lent = np.frombuffer(owner.data, np.uint8)
        weakref.finalize(lent, self._free.append, owner).atexit = False
        return lent[:size]


class ColumnsBuilder:
    """Events of all stages, each batch copied into memory for the `expected` number; full at `most_events`, or one batch."""

    def __init__(
        self, expected: Mapping[Stage, int], most_events: int = sys.maxsize, memory: ColumnsMemory | None = None
    ) -> None:
        self._columns = {stage: _StageColumns(min(most_events, expected.get(stage, 0)), memory) for stage in Stage}
        self._most_events = most_events

    def is_full_before(self, events: int) -> bool:
        filled = sum(columns.filled for columns in self._columns.values())
        return filled > 0 and filled + events > self._most_events

    def append(self, stage: Stage, records: Records) -> int:
        return self._columns[stage].append(records)

    def finish(self) -> dict[Stage, EventColumns]:
        return {stage: columns.finish() for stage, columns in self._columns.items()}


class _StageColumns:
    """Events of one stage, all columns in one piece of memory; unfilled parts are never allocated."""

    def __init__(self, expected: int, memory: ColumnsMemory | None) -> None:
        self.filled = 0
        self._memory = memory
        try:
            self._reserve(expected)
        except MemoryError:  # the file's claim may be wrong; the columns grow as events come
            self._reserve(0)

    def append(self, records: Records) -> int:
        start, end = self.filled, self.filled + len(records)
        if end > self._wide.shape[1]:
            wide, narrow = self._wide[:, :start], self._narrow[:, :start]
            self._reserve(max(end, self._wide.shape[1] * 5 // 4, _SMALLEST_GROWTH))
            self._wide[:, :start], self._narrow[:, :start] = wide, narrow
        count, step = len(records), EVENT_DTYPE.itemsize
        self._wide[:, start:end] = np.ndarray((len(_WIDE), count), "<i8", records, 0, (8, step))
        self._narrow[:, start:end] = np.ndarray((len(_NARROW), count), "<u4", records, _WIDE_BYTES, (4, step))
        left_out = 0
        if _is_beyond(self._wide[_OPTIONAL, start:end]):
            optional = self._wide[_OPTIONAL, start:end]
            optional[_beyond(optional)] = 0  # unknown
        if _is_beyond(self._wide[_INSTANTS, start:end]):
            valid = np.flatnonzero(~_beyond(self._wide[_INSTANTS, start:end]).any(axis=0))
            left_out = count - len(valid)
            end = start + len(valid)
            self._wide[:, start:end] = self._wide[:, start + valid]
            self._narrow[:, start:end] = self._narrow[:, start + valid]
        self.filled = end
        return left_out

    def finish(self) -> EventColumns:
        if not self.filled:
            return EventColumns.empty()
        rows = zip(_NAMES, [*self._wide, *self._narrow], strict=True)
        return EventColumns(**{name: row[: self.filled].view(EVENT_DTYPE[name]) for name, row in rows})

    def _reserve(self, count: int) -> None:
        size = count * EVENT_DTYPE.itemsize
        memory = self._memory.lend(size) if self._memory else np.empty(size, np.uint8)
        split = count * _WIDE_BYTES
        self._wide = memory[:split].view("<i8").reshape(len(_WIDE), count)
        self._narrow = memory[split:].view("<u4").reshape(len(_NARROW), count)


def _is_beyond(stamps: NDArray[np.int64]) -> bool:
    return bool(stamps.size) and (int(stamps.min()) < -MOST_STAMP_NS or int(stamps.max()) > MOST_STAMP_NS)


def _beyond(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    return (stamps < -MOST_STAMP_NS) | (stamps > MOST_STAMP_NS)


PIECE_EVENTS = 1 << 18
"""Most events of a piece (15 MB), unless a chunk has more."""

_MOST_WORKERS = 4  # more threads wait for memory, not for each other


def read_trace(path: str | os.PathLike[str]) -> Trace:
    """Read a whole trace.

    Args:
        path: a `.mcap` file (with its ring, if a killed recorder left one) or a rosbag2 folder.

    Raises:
        TraceFormatError: `path` is not a trace, or a description in it cannot be read. A file that ends early or is damaged
            is no error: see `Trace.truncated` and `Trace.notes`.
    """
    whole: dict[Stage, EventColumns] = {}
    return replace(_read(Path(path), whole.update, sys.maxsize), events=whole)


def read_trace_in_pieces(path: Path, take: Callable[[Mapping[Stage, EventColumns]], object]) -> Trace:
    """Read a trace without all its events in memory at once, and return it without them; errors as for `read_trace`.

    `take` is called at least once, in file order, with up to `PIECE_EVENTS` events of all stages (a stage may be
    empty), and its memory is reused when nothing refers to it.
    """
    return _read(path, take, PIECE_EVENTS)


def _read(path: Path, take: Callable[[Mapping[Stage, EventColumns]], object], most_events: int) -> Trace:
    builder = TraceBuilder(path)
    files = storage_files(path)
    rings = [ring_beside(file) for file in files]
    with _workers() as pool, ExitStack() as opened:
        sources = [opened.enter_context(open_source(file, pool)) for file in files]
        expected = Counter[Stage]()
        for source in sources:
            expected.update(source.expected_events())
        memory = ColumnsMemory() if most_events < sys.maxsize else None
        columns = ColumnsBuilder(expected, most_events, memory)
        for file, source, ring in zip(files, sources, rings, strict=True):
            for batch in builder.batches_of(file, source, ring):
                if columns.is_full_before(sum(len(events) for _, events in batch.events)):
                    take(columns.finish())
                    columns = ColumnsBuilder(expected, most_events, memory)
                for stage, events in batch.events:
                    builder.unreadable += columns.append(stage, events)
        take(columns.finish())
        return builder.trace({})


def iter_event_batches(path: str | os.PathLike[str]) -> Iterator[tuple[Stage, EventColumns]]:
    """Yield the events of a trace about a megabyte at a time, of each stage in file order."""
    path = Path(path)
    builder = TraceBuilder(path)
    for file in storage_files(path):
        ring = ring_beside(file)
        with _workers() as pool, open_source(file, pool) as source:
            for batch in builder.batches_of(file, source, ring):
                for stage, events in batch.events:
                    columns = ColumnsBuilder({stage: len(events)})
                    columns.append(stage, events)
                    yield stage, columns.finish()[stage]
    builder.check()


def _workers() -> ThreadPoolExecutor:
    others = len(os.sched_getaffinity(0)) - 1
    return ThreadPoolExecutor(max(1, min(_MOST_WORKERS, others)), thread_name_prefix="read_trace")
