"""A trace as one file: its events, and, in the cache, its description as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, BinaryIO, TypedDict

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.files import replacing
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.events import EventColumns, Stage
from dds_trace.tracefile.reading.trace import Trace

from .event_index import EventKey, EventPart
from .events import Column, EventsFile, StoredEvents, StoredPiece
from .loaded import LoadedTrace, load_trace

if TYPE_CHECKING:
    import hmac
    from pathlib import Path

    from dds_trace.tracefile.format.json_fields import JsonObject

    from .store import Sealer, TraceCache


Fill = Callable[["StoredParts"], Trace]
"""Adds all events of a trace and returns the trace without them."""


_FORMAT = 6
"""Version of an entry; another version is ignored."""


class StoredParts:
    """Writes, and perhaps seals, the events of one trace into a stream, piece by piece."""

    def __init__(self, stream: BinaryIO, sealer: Sealer | None) -> None:
        self._file = EventsFile(stream)
        self._sealer = sealer
        self._pieces: dict[EventKey, list[tuple[int, int, StoredPiece]]] = {}
        self._seals: dict[EventKey, hmac.HMAC] = {}

    def add(self, parts: Mapping[EventKey, EventPart]) -> None:
        for key, part in parts.items():
            events = part.load()
            piece = self._file.write(events)
            self._pieces.setdefault(key, []).append((part.first_ns, part.last_ns, piece))
            if self._sealer is not None:
                self._seals[key] = self._sealer.seal_events(piece.arrays(events), self._seals.get(key))

    def index(self, file: Path, position: int) -> dict[EventKey, EventPart]:
        index = {}
        for key, written in self._pieces.items():
            firsts_ns, lasts_ns, pieces = zip(*written, strict=True)
            stored = StoredEvents(file, pieces)
            index[key] = EventPart(position, stored.count, min(firsts_ns), max(lasts_ns), stored)
        return index

    @property
    def seals(self) -> list[str]:
        return [seal.hexdigest() for seal in self._seals.values()]


def store_parts(file: Path, position: int, fill: Fill) -> LoadedTrace:
    """Write the events of a trace into a file, which replaces `file` once complete.

    Raises:
        OSError: the file cannot be written.
        TraceFormatError: from `fill`.
    """
    with replacing(file) as draft, draft.open("wb") as stream:
        return _store(stream, file, position, fill, None)[0]


def write_entry(cache: TraceCache, key: str, position: int, fill: Fill) -> LoadedTrace:
    """Write an entry of the cache: events, then the description; `key` identifies the trace's content.

    Raises:
        OSError: it cannot be written.
        TraceFormatError: from `fill`.
    """
    file = cache.path(key, "trace")
    with replacing(file) as draft, draft.open("wb") as stream:
        loaded, seals = _store(stream, file, position, fill, cache.sealer)
        cache.write_end(key, stream, json.dumps(_to_dict(loaded, seals)).encode())
    return _in_cache(loaded, [None] * len(seals))


def _store(
    stream: BinaryIO, file: Path, position: int, fill: Fill, sealer: Sealer | None
) -> tuple[LoadedTrace, list[str]]:
    stored = StoredParts(stream, sealer)
    trace = fill(stored)
    return LoadedTrace(trace, stored.index(file, position)), stored.seals


def read_entry(cache: TraceCache, key: str, path: Path, position: int) -> LoadedTrace | None:
    """Return the trace of this key, None without a usable entry."""
    try:
        text, events_bytes = cache.read_end(key)
        entry: _Entry = json.loads(text)
        if entry["format"] != _FORMAT:
            return None
        checks = [(cache.sealer, seal) for seal in entry["seals"]]
        loaded = _from_dict(entry, cache.path(key, "trace"), events_bytes, path, position)
        return _in_cache(loaded, checks)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, TraceFormatError):
        return None


@dataclass(frozen=True, slots=True)
class _CachedEvents:
    """Cached events, read from their trace if the cache no longer has them as sealed."""

    stored: StoredEvents
    check: tuple[Sealer, str] | None
    label: EventKey
    trace: Path

    def load(self) -> EventColumns:
        """Read the events.

        Raises:
            TraceFormatError: neither the cache nor the trace has them any more.
        """
        with suppress(OSError):
            events = self.stored.load()
            if self.check is None:
                return events
            sealer, seal = self.check
            if sealer.seal_events(self.stored.arrays(events)).hexdigest() == seal:
                return events
        part = load_trace(self.trace, 0).parts.get(self.label)
        if part is None or part.count != self.stored.count:
            raise TraceFormatError(self.trace, "changed while it was analyzed; analyze again")
        return part.load()


def _in_cache(loaded: LoadedTrace, checks: Sequence[tuple[Sealer, str] | None]) -> LoadedTrace:
    parts = {
        label: replace(part, events=_CachedEvents(part.events, check, label, loaded.trace.path))
        for (label, part), check in zip(loaded.parts.items(), checks, strict=True)
        if isinstance(part.events, StoredEvents)
    }
    return LoadedTrace(loaded.trace, parts)


class _Entry(TypedDict):
    format: int
    seals: list[str]
    sessions: list[str]
    runs: list[str]
    host_samples: list[JsonObject]
    wire: list[JsonObject]
    publishers: list[JsonObject]
    truncated: str | None
    ring_events: int
    unreadable_messages: int
    notes: list[str]
    parts: list[tuple[str, int, int, int, int, list[tuple[int, dict[str, Column]]]]]
    """Stage, run, relay, first and last ns; number of events and columns of each piece."""


def _to_dict(loaded: LoadedTrace, seals: list[str]) -> _Entry:
    trace = loaded.trace
    stored = [part.events for part in loaded.parts.values() if isinstance(part.events, StoredEvents)]
    return {
        "format": _FORMAT,
        "seals": seals,
        "sessions": [session.to_json() for session in trace.sessions],
        "runs": [run.to_json() for run in trace.runs],
        "host_samples": [dict(sample) for sample in trace.host_samples],
        "wire": [dict(text) for text in trace.wire],
        "publishers": [dict(text) for text in trace.publishers],
        "truncated": trace.truncated,
        "ring_events": trace.ring_events,
        "unreadable_messages": trace.unreadable_messages,
        "notes": list(trace.notes),
        "parts": [
            (
                stage.value,
                run_id,
                relay_id,
                part.first_ns,
                part.last_ns,
                [(piece.count, dict(piece.columns)) for piece in events.pieces],
            )
            for ((stage, run_id, relay_id), part), events in zip(loaded.parts.items(), stored, strict=True)
        ],
    }


def _from_dict(entry: _Entry, file: Path, events_bytes: int, path: Path, position: int) -> LoadedTrace:
    parts = {}
    for stage, run_id, relay_id, first_ns, last_ns, descriptions in entry["parts"]:
        pieces = (
            StoredPiece(count, {name: (how, value) for name, (how, value) in columns.items()})
            for count, columns in descriptions
        )
        events = StoredEvents(file, tuple(pieces))
        events.check(events_bytes)
        parts[Stage(stage), run_id, relay_id] = EventPart(position, events.count, first_ns, last_ns, events)
    trace = Trace(
        path=path,
        sessions=tuple(Session.from_json(text, path) for text in entry["sessions"]),
        runs=tuple(Run.from_json(text, path) for text in entry["runs"]),
        events={},
        host_samples=tuple(entry["host_samples"]),
        wire=tuple(entry["wire"]),
        publishers=tuple(entry["publishers"]),
        truncated=entry["truncated"],
        ring_events=entry["ring_events"],
        unreadable_messages=entry["unreadable_messages"],
        notes=tuple(entry["notes"]),
    )
    return LoadedTrace(trace, parts)
