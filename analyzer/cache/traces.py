"""Loads traces; events wait in memory, in the user's cache, or in temporary files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from pathlib import Path

from dds_trace.base.errors import OutputError, TraceFormatError
from dds_trace.tracefile.format.events import EventColumns, Stage
from dds_trace.tracefile.reading.trace import Trace

from .entries import Fill, StoredParts, read_entry, store_parts, write_entry
from .event_index import split_trace
from .loaded import LoadedTrace, load_trace, loaded_or_error, read_in_pieces
from .store import TraceCache

MOST_EVENTS_IN_MEMORY = 12_000_000
"""Events in memory, 56 bytes each; other traces wait in files."""

LARGEST_TRACE_IN_MEMORY = 4_000_000
"""Events of the largest trace in memory; of a larger one, a batch reads its own."""


class TraceLoader:
    """Loads traces from the cache or from their files; the cache is closed with it.

    Without a `folder` for temporary files, it makes one. `keys`: index of a loaded trace -> its key in the cache.
    """

    def __init__(self, cache: TraceCache | None = None, folder: Path | None = None) -> None:
        self._cache = cache
        self._folder = folder
        self.keys: dict[int, str] = {}
        self._left = MOST_EVENTS_IN_MEMORY
        self._own_folder: tempfile.TemporaryDirectory[str] | None = None
        # Writes while the next piece, or the next trace, is read.
        self._writing = ThreadPoolExecutor(1, thread_name_prefix="keep")

    def use_files(self) -> None:
        self._left = 0

    def load_all(self, paths: Sequence[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        """Load traces; yield an error, without an index, for a file that is not one."""
        position = 0
        for path in paths:
            loaded = loaded_or_error(self.load, path, position)
            position += isinstance(loaded, LoadedTrace)
            yield loaded

    def load(self, path: Path, position: int) -> LoadedTrace:
        """Load one trace.

        Raises:
            TraceFormatError: it is not a trace.
        """
        cached = self._cached(path, position)
        if cached is not None:
            return cached
        if not self._left:
            return self._store_in_pieces(path, position)
        loaded = load_trace(path, position)
        if loaded.events > min(self._left, LARGEST_TRACE_IN_MEMORY):
            return self._store(path, position, partial(_add_loaded, loaded))
        self._left -= loaded.events
        if self._cache:
            fill = partial(_add_loaded, loaded)
            self._writing.submit(_write_if_possible, self._cache, self.keys[position], position, fill)
        return loaded

    def store(self, path: Path, position: int) -> LoadedTrace:
        """Load one trace, its events in a file that another process can read.

        Raises:
            TraceFormatError: it is not a trace.
            OutputError: the events cannot be written.
        """
        return self._cached(path, position) or self._store_in_pieces(path, position)

    def close(self) -> None:
        self._writing.shutdown(cancel_futures=True)
        if self._own_folder is not None:
            self._own_folder.cleanup()
        if self._cache is not None:
            self._cache.close()

    def _cached(self, path: Path, position: int) -> LoadedTrace | None:
        if self._cache is None:
            return None
        key = self.keys[position] = self._cache.key_of(path)
        return read_entry(self._cache, key, path, position)

    def _store_in_pieces(self, path: Path, position: int) -> LoadedTrace:
        return self._store(path, position, partial(self._add_pieces, path, position))

    def _store(self, path: Path, position: int, fill: Fill) -> LoadedTrace:
        if self._cache:
            cached = _write_if_possible(self._cache, self.keys[position], position, fill)
            if cached is not None:
                return cached
        try:
            if self._folder is None:
                self._own_folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")
                self._folder = Path(self._own_folder.name)
            return store_parts(self._folder / f"{position}.events", position, fill)
        except OSError as err:
            raise OutputError(
                f"events of {path} cannot be written to a temporary file ({err}); give a larger folder with TMPDIR"
            ) from err

    def _add_pieces(self, path: Path, position: int, stored: StoredParts) -> Trace:
        writing: list[Future[None]] = []
        last: list[Mapping[Stage, EventColumns]] = []

        def add(events: Mapping[Stage, EventColumns]) -> None:
            stored.add(split_trace(events, position))

        def take(events: Mapping[Stage, EventColumns]) -> None:
            if last and not any(future.exception() for future in writing):  # waits for the previous piece
                writing[:] = [self._writing.submit(add, last.pop())]
            last[:] = [events]

        try:
            trace = read_in_pieces(path, take)
        finally:
            wait(writing)
        for future in writing:
            future.result()
        for events in last:  # the only piece of a small trace
            add(events)
        return trace


def _add_loaded(loaded: LoadedTrace, stored: StoredParts) -> Trace:
    stored.add(loaded.parts)
    return loaded.trace


def _write_if_possible(cache: TraceCache, key: str, position: int, fill: Fill) -> LoadedTrace | None:
    """Return None on failure: a full disk costs only the cache."""
    with suppress(OSError):
        return write_entry(cache, key, position, fill)
    return None
