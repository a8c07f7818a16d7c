"""Events of traces, kept until their batch is worked at: in memory, or in files of our own.

Read traces are put into the user's cache by what is in them (`cache.py`, `entries.py`), so that the next analysis reads only
new ones.
"""

from __future__ import annotations

import tempfile
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import OutputError, TraceFormatError

from .entries import read_entry, store_parts, write_entry
from .event_index import split_trace
from .loaded import LoadedTrace, load_trace, loaded_or_error, read_in_pieces

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from concurrent.futures import Future

    from dds_trace.tracefile.format.events import EventColumns, Stage
    from dds_trace.tracefile.reading.trace import Trace

    from .entries import Fill, StoredParts
    from .store import TraceCache

MOST_HELD_EVENTS = 12_000_000
"""Events that stay in memory, 56 bytes each; those of further traces wait in files."""

LARGEST_HELD_EVENTS = 4_000_000
"""Events of the largest trace that stays in memory: while a batch is worked at, only its own part of a larger one is there."""


class TraceShelf:
    """Reads traces and keeps their events.

    Args:
        cache: the open cache that keeps events for the next analysis, closed with the shelf; None keeps nothing.
        folder: takes temporary files; None: one of its own, removed with the shelf.

    Attributes:
        keys: position of a trace that was loaded -> its key in the cache; empty without one.
    """

    def __init__(self, cache: TraceCache | None = None, folder: Path | None = None) -> None:
        self._cache = cache
        self._folder = folder
        self.keys: dict[int, str] = {}
        self._left = MOST_HELD_EVENTS
        self._own_folder: tempfile.TemporaryDirectory[str] | None = None
        # Writes while the next piece, or the next trace, is read.
        self._keeping = ThreadPoolExecutor(1, thread_name_prefix="keep")

    def hold_no_more(self) -> None:
        """Put the events of all further traces into files."""
        self._left = 0

    def load_all(self, paths: Sequence[Path]) -> Iterator[LoadedTrace | TraceFormatError]:
        """Load traces, positions counted without what is none; of such a file the error is yielded."""
        position = 0
        for path in paths:
            found = loaded_or_error(self.load, path, position)
            position += isinstance(found, LoadedTrace)
            yield found

    def load(self, path: Path, position: int) -> LoadedTrace:
        """Load one trace, from the cache if it is there.

        Raises:
            TraceFormatError: it is no trace.
        """
        known = self._known(path, position)
        if known is not None:
            return known
        if not self._left:
            return self._stored(path, position)
        loaded = load_trace(path, position)
        if loaded.events > min(self._left, LARGEST_HELD_EVENTS):
            return self._put_away(path, position, partial(_add_loaded, loaded))
        self._left -= loaded.events
        if self._cache:
            self._keeping.submit(
                _keep_if_it_can, self._cache, self.keys[position], position, partial(_add_loaded, loaded)
            )
        return loaded

    def store(self, path: Path, position: int) -> LoadedTrace:
        """Load one trace, its events not in memory but in a file: another process can have them.

        Raises:
            TraceFormatError: it is no trace.
            OutputError: events cannot be kept.
        """
        return self._known(path, position) or self._stored(path, position)

    def close(self) -> None:
        """Remove temporary files and close the cache."""
        self._keeping.shutdown(cancel_futures=True)
        if self._own_folder is not None:
            self._own_folder.cleanup()
        if self._cache is not None:
            self._cache.close()

    def _known(self, path: Path, position: int) -> LoadedTrace | None:
        """Return the trace from the cache, if it is there; its key is known then in any case."""
        if self._cache is None:
            return None
        key = self.keys[position] = self._cache.key_of(path)
        return read_entry(self._cache, key, path, position)

    def _stored(self, path: Path, position: int) -> LoadedTrace:
        return self._put_away(path, position, partial(self._add_pieces, path, position))

    def _put_away(self, path: Path, position: int, fill: Fill) -> LoadedTrace:
        """Put the events of a trace into the cache, or, without one, into a temporary file."""
        if self._cache:
            kept = _keep_if_it_can(self._cache, self.keys[position], position, fill)
            if kept is not None:
                return kept
        try:
            if self._folder is None:
                self._own_folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")
                self._folder = Path(self._own_folder.name)
            return store_parts(self._folder / f"{position}.events", position, fill)
        except OSError as err:
            raise OutputError(
                f"events of {path} cannot be kept ({err}); give a larger folder with TMPDIR"
            ) from err

    def _add_pieces(self, path: Path, position: int, stored: StoredParts) -> Trace:
        """Read a trace and add its events; a piece is put away while the next ones are read.

        Raises:
            OSError: they cannot be put away.
            TraceFormatError: it is no trace.
        """
        adding: list[Future[None]] = []
        last: list[Mapping[Stage, EventColumns]] = []

        def add(events: Mapping[Stage, EventColumns]) -> None:
            stored.add(split_trace(events, position))

        def take(events: Mapping[Stage, EventColumns]) -> None:
            if last and not any(each.exception() for each in adding):  # waits for the piece before it
                adding[:] = [self._keeping.submit(add, last.pop())]
            last[:] = [events]

        try:
            trace = read_in_pieces(path, take)
        finally:
            wait(adding)
        for each in adding:
            each.result()
        for events in last:  # that of a small trace is its only one, which needs no other thread
            add(events)
        return trace


def _add_loaded(loaded: LoadedTrace, stored: StoredParts) -> Trace:
    stored.add(loaded.parts)
    return loaded.trace


def _keep_if_it_can(cache: TraceCache, key: str, position: int, fill: Fill) -> LoadedTrace | None:
    """Write an entry; None where it cannot be written: a full disk costs the cache, not the analysis."""
    with suppress(OSError):
        return write_entry(cache, key, position, fill)
    return None
