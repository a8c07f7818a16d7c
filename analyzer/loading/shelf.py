"""Events of traces, kept until their batch is worked at: in memory, or in files of our own.

Read traces are put into the user's cache by what is in them (`analyzer/loading/cache.py`), so that the next analysis reads
only new ones.
"""

from __future__ import annotations

import json
import tempfile
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from sys import getsizeof
from typing import TYPE_CHECKING, TypedDict

from dds_trace.tracefile import OutputError, Run, Session, Stage, Trace, TraceFormatError, read_trace

from .event_store import StoredEvents, write_events
from .events import EventPart, split_trace
from .remote import local_copy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from concurrent.futures import Future

    from dds_trace.tracefile import EventColumns
    from dds_trace.tracefile.format.json_fields import JsonObject

    from .cache import Sealer, TraceCache
    from .events import EventKey, EventsElsewhere

MOST_HELD_EVENTS = 12_000_000
"""Events that stay in memory, 56 bytes each; those of further traces wait in files."""

LARGEST_HELD_EVENTS = 4_000_000
"""Events of the largest trace that stays in memory: while a batch is worked at, only its own part of a larger one is there."""

_FORMAT = 2
"""Version of an entry; an entry of another version, or without a field of this one, is not used. 1: the first; 2: seals of the events."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrace:
    """One trace, with the index of its events.

    Attributes:
        trace: the trace without its events.
        parts: the event index of the trace.
    """

    trace: Trace
    parts: Mapping[EventKey, EventPart]

    def __sizeof__(self) -> int:
        return object.__sizeof__(self) + sum(map(getsizeof, self.parts.values()))

    @property
    def events(self) -> int:
        """Number of its events."""
        return sum(part.count for part in self.parts.values())

    def at(self, position: int) -> LoadedTrace:
        """Return the trace at another position in its campaign."""
        return LoadedTrace(
            self.trace, {label: replace(part, trace=position) for label, part in self.parts.items()}
        )


def load_trace(path: Path, position: int) -> LoadedTrace:
    """Read one trace, events in memory.

    Raises:
        TraceFormatError: it is no trace, cannot be read, or nothing was ever written into it.
    """
    with local_copy(path) as local:
        try:
            trace = replace(read_trace(local), path=path)
        except OSError as err:
            raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
        except TraceFormatError as err:
            raise TraceFormatError(path, err.what) from err
    if not (trace.sessions or trace.runs or trace.event_count):
        raise TraceFormatError(path, f"holds nothing of a trace ({trace.truncated or 'it is complete'})")
    return LoadedTrace(replace(trace, events={}), split_trace(trace, position))


def loaded_or_error(
    load: Callable[[Path, int], LoadedTrace], path: Path, position: int
) -> LoadedTrace | TraceFormatError:
    """Load one trace, or return why it is none."""
    try:
        return load(path, position)
    except TraceFormatError as err:
        return err


@dataclass(frozen=True, slots=True)
class _KeptEvents:
    """Events of one stage, run and relay in the cache; read from their trace again where it no longer has them as written.

    Attributes:
        stored: their place.
        check: what makes their seal, and the seal that they are to have; None where this analysis has put them there.
        label: stage, run and relay.
        trace: path of their trace.
    """

    stored: StoredEvents
    check: tuple[Sealer, str] | None
    label: EventKey
    trace: Path

    def load(self) -> EventColumns:
        """Read the events.

        Raises:
            TraceFormatError: they are gone, and the trace no longer has them.
        """
        with suppress(OSError):
            events = self.stored.load()
            if self.check is None:
                return events
            sealer, seal = self.check
            if sealer.seal_of(*self.stored.arrays(events)) == seal:
                return events
        part = load_trace(self.trace, 0).parts.get(self.label)
        if part is None or part.count != self.stored.count:
            raise TraceFormatError(self.trace, "changed while it was analyzed; analyze again")
        return part.load()


@dataclass(frozen=True, slots=True, eq=False)
class _EventsBeingStored:
    """Events of one stage, run and relay of a trace that is put into a file meanwhile.

    Attributes:
        stored: the trace with the places of its events, once they are written.
        label: stage, run and relay.
    """

    stored: Future[LoadedTrace]
    label: EventKey

    def load(self) -> EventColumns:
        """Read the events, once they are written.

        Raises:
            OutputError: they could not be kept.
            TraceFormatError: they are gone, and the trace no longer has them.
        """
        return self.stored.result().parts[self.label].load()

    def __reduce__(self) -> tuple[Callable[[EventPart], object], tuple[EventPart]]:
        """Give another process the place of the events in their file, once they are written."""
        return _events_of, (self.stored.result().parts[self.label],)


def _events_of(part: EventPart) -> EventColumns | EventsElsewhere:
    return part.events


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
        # Writes while the next trace is read.
        self._keeping = ThreadPoolExecutor(1, thread_name_prefix="keep")
        self._storing: Future[LoadedTrace] | None = None

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
        key, loaded = self.keys.get(position, ""), load_trace(path, position)
        if loaded.events <= min(self._left, LARGEST_HELD_EVENTS):
            self._left -= loaded.events
            if self._cache:
                self._keeping.submit(_keep_if_it_can, self._cache, key, loaded)
            return loaded
        if self._storing is not None:
            wait([self._storing])  # one trace at a time is in memory beside the one that is read
        self._storing = self._keeping.submit(self._kept_or_spilled, key, loaded, position)
        parts = {
            label: replace(part, events=_EventsBeingStored(self._storing, label))
            for label, part in loaded.parts.items()
        }
        return LoadedTrace(loaded.trace, parts)

    def store(self, path: Path, position: int) -> LoadedTrace:
        """Load one trace as `load` does, but its events are in a file when this returns: another process can have them.

        Raises:
            TraceFormatError: it is no trace.
            OutputError: events cannot be kept.
        """
        known = self._known(path, position)
        if known is not None:
            return known
        return self._kept_or_spilled(self.keys.get(position, ""), load_trace(path, position), position)

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
        return _known(self._cache, key, path, position)

    def _kept_or_spilled(self, key: str, loaded: LoadedTrace, position: int) -> LoadedTrace:
        kept = _keep_if_it_can(self._cache, key, loaded) if self._cache else None
        return kept or self._spilled(loaded, position)

    def _spilled(self, loaded: LoadedTrace, position: int) -> LoadedTrace:
        """Put the events into a temporary file."""
        try:
            if self._folder is None:
                self._own_folder = tempfile.TemporaryDirectory(prefix="dds-analyze-")
                self._folder = Path(self._own_folder.name)
            return _stored(self._folder / f"{position}.events", loaded)
        except OSError as err:
            raise OutputError(
                f"events of {loaded.trace.path} cannot be kept ({err}); give a larger folder with TMPDIR"
            ) from err


def _stored(file: Path, loaded: LoadedTrace) -> LoadedTrace:
    """Write the events into a file of ours; return the trace with their places."""
    written = write_events(file, {label: part.load() for label, part in loaded.parts.items()})
    parts = {label: replace(part, events=written[label]) for label, part in loaded.parts.items()}
    return LoadedTrace(loaded.trace, parts)


def _keep_if_it_can(cache: TraceCache, key: str, loaded: LoadedTrace) -> LoadedTrace | None:
    """Write an entry; None where it cannot be written: a full disk costs the cache, not the analysis."""
    with suppress(OSError):
        return _keep(cache, key, loaded)
    return None


def _keep(cache: TraceCache, key: str, loaded: LoadedTrace) -> LoadedTrace:
    """Write an entry; the description last, so that it never names events that are not there.

    Raises:
        OSError: it cannot be written.
    """
    stored = _stored(cache.events_path(key), loaded)
    seals = [
        cache.sealer.seal_of(*part.events.arrays(whole.load()))
        for part, whole in zip(stored.parts.values(), loaded.parts.values(), strict=True)
        if isinstance(part.events, StoredEvents)
    ]
    cache.write(key, "json", json.dumps(_to_dict(stored, seals)).encode())
    return _in_cache(stored, [None] * len(seals))


def _in_cache(loaded: LoadedTrace, checks: Sequence[tuple[Sealer, str] | None]) -> LoadedTrace:
    """Return the trace with events that are read where they are stored, each with its check (`_KeptEvents`)."""
    parts = {
        label: replace(part, events=_KeptEvents(part.events, check, label, loaded.trace.path))
        for (label, part), check in zip(loaded.parts.items(), checks, strict=True)
        if isinstance(part.events, StoredEvents)
    }
    return LoadedTrace(loaded.trace, parts)


class _Entry(TypedDict):
    """The JSON of an entry: a trace without its events, and the places of these in the file of events."""

    format: int
    bytes: int
    seals: list[str]
    sessions: list[str]
    runs: list[str]
    host_samples: list[JsonObject]
    wire: list[JsonObject]
    truncated: str | None
    ring_events: int
    unreadable_messages: int
    notes: list[str]
    parts: list[tuple[str, int, int, int, int, int, dict[str, tuple[str, int]]]]


def _known(cache: TraceCache, key: str, path: Path, position: int) -> LoadedTrace | None:
    """Return the entry of this content; None if the cache has none that can be used."""
    try:
        entry: _Entry = json.loads(cache.read(key, "json"))
        file = cache.events_path(key)
        if entry["format"] != _FORMAT or file.stat().st_size != entry["bytes"]:
            return None
        checks = [(cache.sealer, seal) for seal in entry["seals"]]
        return _in_cache(_from_dict(entry, file, path, position), checks)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, TraceFormatError):
        return None


def _to_dict(loaded: LoadedTrace, seals: list[str]) -> _Entry:
    trace = loaded.trace
    stored = [part.events for part in loaded.parts.values() if isinstance(part.events, StoredEvents)]
    return {
        "format": _FORMAT,
        "bytes": stored[0].file.stat().st_size if stored else 0,
        "seals": seals,
        "sessions": [session.to_json() for session in trace.sessions],
        "runs": [run.to_json() for run in trace.runs],
        "host_samples": [dict(sample) for sample in trace.host_samples],
        "wire": [dict(text) for text in trace.wire],
        "truncated": trace.truncated,
        "ring_events": trace.ring_events,
        "unreadable_messages": trace.unreadable_messages,
        "notes": list(trace.notes),
        "parts": [
            (stage.value, run_id, relay_id, part.count, part.first_ns, part.last_ns, dict(events.columns))
            for ((stage, run_id, relay_id), part), events in zip(loaded.parts.items(), stored, strict=True)
        ],
    }


def _from_dict(entry: _Entry, file: Path, path: Path, position: int) -> LoadedTrace:
    parts = {}
    for stage, run_id, relay_id, count, first_ns, last_ns, columns in entry["parts"]:
        events = StoredEvents(file, count, {name: (how, value) for name, (how, value) in columns.items()})
        events.check(entry["bytes"])
        parts[Stage(stage), run_id, relay_id] = EventPart(position, count, first_ns, last_ns, events)
    trace = Trace(
        path=path,
        sessions=tuple(Session.from_json(text, path) for text in entry["sessions"]),
        runs=tuple(Run.from_json(text, path) for text in entry["runs"]),
        events={},
        host_samples=tuple(entry["host_samples"]),
        wire=tuple(entry["wire"]),
        truncated=entry["truncated"],
        ring_events=entry["ring_events"],
        unreadable_messages=entry["unreadable_messages"],
        notes=tuple(entry["notes"]),
    )
    return LoadedTrace(trace, parts)
