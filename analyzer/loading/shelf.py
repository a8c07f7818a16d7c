"""Events of traces, kept until their batch is worked at: in memory, or in files of our own.

Read traces are put into the cache folder of an analysis by what is in them, so that the next analysis reads only
new ones. An entry is two files: `KEY.json`, the trace without its events, and `KEY.events` (see
`analyzer/loading/event_store.py`). KEY is the SHA-1 of the trace's files, those beside it that belong to it included.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from dds_trace.tracefile import OutputError, Run, Session, Stage, Trace, TraceFormatError, read_trace
from dds_trace.tracefile.files import replacing

from .event_store import StoredEvents, write_events
from .events import EventPart, split_trace
from .remote import is_remote, local_copy, remote_key

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.tracefile.format.json_fields import JsonObject

    from .events import EventKey

MOST_HELD_EVENTS = 24_000_000
"""Events that stay in memory, 56 bytes each; those of further traces wait in files."""

_FORMAT = 1
"""Version of an entry; an entry of another version, or without a field of this one, is not used. 1: the first."""

_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrace:
    """One trace, with the index of its events.

    Attributes:
        trace: the trace without its events.
        parts: the event index of the trace.
    """

    trace: Trace
    parts: Mapping[EventKey, EventPart]

    @property
    def events(self) -> int:
        """Number of its events."""
        return sum(part.count for part in self.parts.values())


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


class TraceShelf:
    """Reads traces and keeps their events.

    Args:
        cache: folder that keeps events for the next analysis; None keeps nothing.
    """

    def __init__(self, cache: Path | None = None) -> None:
        self._cache = cache
        self._left = MOST_HELD_EVENTS
        self._spill: tempfile.TemporaryDirectory[str] | None = None
        self._used: set[str] = set()

    def load(self, path: Path, position: int) -> LoadedTrace:
        """Load one trace, from the cache if it is there.

        Raises:
            TraceFormatError: it is no trace.
            OutputError: the cache, or the folder for temporary files, cannot be written.
        """
        key = content_key(path) if self._cache else ""
        if self._cache and (known := _known(self._cache, key, path, position)):
            self._used.add(key)
            return known
        loaded = load_trace(path, position)
        held = loaded.events <= self._left
        try:
            if self._cache:
                self._used.add(key)
                stored = self._store(self._cache, key, loaded)
                loaded = loaded if held else stored
            elif not held:
                if self._spill is None:
                    self._spill = tempfile.TemporaryDirectory(prefix="dds-analyze-")
                loaded = self._store(Path(self._spill.name), str(position), loaded)
        except OSError as err:
            raise OutputError(
                f"events of {path} cannot be kept ({err}); give another folder with --out, "
                "or a larger one with TMPDIR"
            ) from err
        if held:
            self._left -= loaded.events
        return loaded

    def close(self) -> None:
        """Remove temporary files, and entries of the cache for traces that are no longer there."""
        if self._spill is not None:
            self._spill.cleanup()
        if self._cache and self._cache.is_dir():
            for entry in self._cache.iterdir():
                if entry.name.split(".")[0] not in self._used:
                    entry.unlink(missing_ok=True)

    @staticmethod
    def _store(folder: Path, key: str, loaded: LoadedTrace) -> LoadedTrace:
        """Write an entry; the description last, so that it never names events that are not there."""
        folder.mkdir(parents=True, exist_ok=True)
        events = folder / f"{key}.events"
        written = write_events(events, {label: part.load() for label, part in loaded.parts.items()})
        parts = {label: replace(part, events=written[label]) for label, part in loaded.parts.items()}
        with replacing(folder / f"{key}.json") as draft:
            draft.write_text(json.dumps(_to_dict(LoadedTrace(loaded.trace, parts))))
        return LoadedTrace(loaded.trace, parts)


def content_key(path: Path) -> str:
    """Hash a trace's content: the file and those beside it under its name (a ring), or the files of a folder.

    Raises:
        TraceFormatError: it cannot be read.
    """
    digest = hashlib.sha1(usedforsecurity=False)
    if is_remote(path):
        digest.update(remote_key(path).encode())
        return digest.hexdigest()
    try:
        files = path.rglob("*") if path.is_dir() else path.parent.glob("*")
        own = sorted(
            file for file in files if file.is_file() and (path.is_dir() or file.name.startswith(path.name))
        )
        for file in own:
            digest.update(
                f"{os.path.relpath(file, path.parent)[len(path.name) :]}\0{file.stat().st_size}\0".encode()
            )
            with file.open("rb") as stream:
                while block := stream.read(_BLOCK_BYTES):
                    digest.update(block)
    except OSError as err:
        raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
    return digest.hexdigest()


class _Entry(TypedDict):
    """The JSON of an entry: a trace without its events, and the places of these in the file of events."""

    format: int
    bytes: int
    sessions: list[str]
    runs: list[str]
    host_samples: list[JsonObject]
    wire: list[JsonObject]
    truncated: str | None
    ring_events: int
    unreadable_messages: int
    notes: list[str]
    parts: list[tuple[str, int, int, int, int, int, dict[str, tuple[str, int]]]]


def _known(folder: Path, key: str, path: Path, position: int) -> LoadedTrace | None:
    """Return the entry of this content; None if the cache has none that can be used."""
    try:
        entry: _Entry = json.loads((folder / f"{key}.json").read_text())
        if entry["format"] != _FORMAT or (folder / f"{key}.events").stat().st_size != entry["bytes"]:
            return None
        return _from_dict(entry, folder / f"{key}.events", path, position)
    except (OSError, ValueError, KeyError, TypeError, TraceFormatError):
        return None


def _to_dict(loaded: LoadedTrace) -> _Entry:
    trace = loaded.trace
    stored = [part.events for part in loaded.parts.values() if isinstance(part.events, StoredEvents)]
    return {
        "format": _FORMAT,
        "bytes": stored[0].file.stat().st_size if stored else 0,
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
