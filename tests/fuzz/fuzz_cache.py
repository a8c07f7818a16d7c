"""Fuzz target `cache`: whatever lies in the cache, a trace is loaded as if there were none."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

from cache_entries import describe_anew
from fuzz_shapes import changed, changed_fields, shaped, shaped_seeds
from trace_files import Message, ping_events, ping_session, run, write_trace

from dds_trace.analyzer.cache.loaded import load_trace
from dds_trace.analyzer.cache.store import TraceCache
from dds_trace.analyzer.cache.traces import TraceLoader
from dds_trace.base.errors import TraceError

if TYPE_CHECKING:
    from pathlib import Path

    from dds_trace.analyzer.cache.loaded import LoadedTrace


class Target:
    """Entries of strangers, damaged entries, and entries with hostile values under our own seal."""

    def __init__(self, folder: Path) -> None:
        os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
        os.environ["XDG_STATE_HOME"] = str(folder / "state")
        self._trace = write_trace(
            folder / "t.mcap", ping_session(), [run()], ping_events([Message(n, t1=n * n) for n in range(12)])
        )
        self._expected = load_trace(self._trace, 0)
        shelf, cache = opened()
        self._key = cache.key_of(self._trace)
        shelf.load(self._trace, 0)
        self._path = cache.path(self._key, "trace")
        shelf.close()  # entries are written beside what is read next
        text, self._events_bytes = cache.read_end(self._key)
        self._good = self._path.read_bytes()
        self._entry = json.loads(text)
        self._shapes = (self._stranger, self._changed_end, self._changed_events, self._sealed)

    def try_input(self, data: bytes) -> None:
        """Load the trace beside the entry that the bytes stand for.

        Only an entry under our own seal may say what the trace does not: who has the key is the user himself.
        """
        self._path.write_bytes(self._good)
        sealed = shaped(self._shapes, data)
        shelf, _ = opened()
        loaded = shelf.load(self._trace, 0)
        try:
            found = content_of(loaded)
        except TraceError:
            if not sealed:
                raise
            return
        finally:
            shelf.close()
        if not sealed and found != content_of(self._expected):
            raise AssertionError("an entry was believed that this user did not write")

    def seeds(self) -> dict[str, bytes]:
        """Good entries."""
        return shaped_seeds(
            self._shapes,
            {
                self._stranger: self._good[self._events_bytes :],
                self._changed_end: bytes(3),
                self._changed_events: bytes(3),
                self._sealed: bytes(3),
            },
        )

    def _stranger(self, data: bytes) -> bool:
        """The bytes are all that is behind the events."""
        self._path.write_bytes(self._good[: self._events_bytes] + data)
        return False

    def _changed_end(self, data: bytes) -> bool:
        """The bytes are changes to the sealed JSON, its seal and its size."""
        events, end = self._good[: self._events_bytes], self._good[self._events_bytes :]
        self._path.write_bytes(events + changed(end, data))
        return False

    def _changed_events(self, data: bytes) -> bool:
        """The bytes are changes to the events, and where the entry is cut off."""
        kept = len(self._good) - data[-1] if data else 0
        self._path.write_bytes(changed(self._good, data[:-1])[:kept])
        return False

    def _sealed(self, data: bytes) -> bool:
        """The bytes are changes to the values of the JSON, which is then sealed as we do."""
        shelf, cache = opened()
        describe_anew(cache, self._key, changed_fields(self._entry, data))
        shelf.close()
        return True


def opened() -> tuple[TraceLoader, TraceCache]:
    """Return a shelf with the cache, open."""
    cache = TraceCache.open()
    if cache is None:
        raise OSError("no cache can be opened")
    return TraceLoader(cache), cache


def content_of(loaded: LoadedTrace) -> tuple[str, dict[str, list[int]]]:
    """Return a trace's descriptions, and the times of its events by stage, run and relay."""
    times = {str(label): part.load().monotonic_ns.tolist() for label, part in loaded.parts.items()}
    return repr(loaded.trace), times
