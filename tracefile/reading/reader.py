"""A trace read back: all of it, piece by piece, or batch by batch.

The same events come from every kind of file: ours, another tool's, unindexed, cut off, damaged, a rosbag2 folder.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from ..format.events import EventColumns, Stage
from .columns import ColumnsBuilder, ColumnsMemory
from .storage import open_source, storage_files
from .trace import Trace, TraceBuilder, ring_beside

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
    """Read a trace whose events are not all in memory at once, and return it without them; errors as for `read_trace`.

    `take` is called at least once, in file order, with up to `PIECE_EVENTS` events of all stages (a stage may be
    empty), whose memory is reused when nothing refers to it.
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
    """Yield the events of a trace about a megabyte at a time, of each stage in file order.

    Memory follows the size of a chunk, not of the file. `read_trace` has descriptions, notes and the number of
    unreadable messages.
    """
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
    """Return the threads that unpack and check chunks besides the caller's."""
    others = len(os.sched_getaffinity(0)) - 1
    return ThreadPoolExecutor(max(1, min(_MOST_WORKERS, others)), thread_name_prefix="read_trace")
