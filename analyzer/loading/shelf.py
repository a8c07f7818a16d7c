"""Where the events of traces wait until their batch is worked at: in memory, or in files of our own.

Read traces are put into the cache folder of an analysis by what is in them, so that the next analysis reads only
new ones. An entry is two files: `KEY.json`, all that the trace says but its events, and `KEY.events` (see
`analyzer/loading/event_store.py`). KEY is the SHA-1 of the trace's files, those beside it that belong to it included.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import OutputError, Run, Session, Stage, Trace, TraceFormatError, read_trace
from dds_trace.tracefile.files import replacing

from .event_store import StoredEvents, write_events
from .events import EventPart, split_trace
from .remote import is_remote, local_copy, remote_key

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .events import EventKey

MOST_HELD_EVENTS = 24_000_000
"""Events that stay in memory, 56 bytes each; those of further traces wait in files."""

_FORMAT = 1
"""Of an entry; one of another number is not used. 1: the first."""

_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrace:
    """One trace, its events by stage, run and relay.

    Attributes:
        trace: all but the events.
        parts: the events, or where they are.
    """

    trace: Trace
    parts: Mapping[EventKey, EventPart]

    @property
    def events(self) -> int:
        """How many events it holds."""
        return sum(part.count for part in self.parts.values())


def load_trace(path: Path, position: int) -> LoadedTrace:
    """Read one trace, events in memory; a file in which nothing was ever written is none.

    Raises:
        TraceFormatError: it is no trace, or cannot be read.
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
        cache: folder for events that the next analysis may want too; None keeps nothing for it.
        most_held_events: events that stay in memory.

    Attributes:
        read: the traces that were read; the others were in the cache.
    """

    def __init__(self, cache: Path | None = None, *, most_held_events: int | None = None) -> None:
        self._cache = cache
        self._left = MOST_HELD_EVENTS if most_held_events is None else most_held_events
        self._spill: tempfile.TemporaryDirectory[str] | None = None
        self._used: set[str] = set()
        self.read: list[Path] = []

    def load(self, path: Path, position: int) -> LoadedTrace:
        """One trace, from the cache if it was there.

        Raises:
            TraceFormatError: it is no trace.
            OutputError: the cache, or the folder for temporary files, cannot be written.
        """
        key = content_key(path) if self._cache else ""
        if self._cache and (known := _known(self._cache, key, path, position)):
            self._used.add(key)
            return known
        loaded = load_trace(path, position)
        self.read.append(path)
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
        """Remove temporary files, and what the cache holds of traces that are no longer there."""
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
    """SHA-1 of a trace's content: of the file and what lies beside it under its name (a ring), or of a folder's files.

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


def _known(folder: Path, key: str, path: Path, position: int) -> LoadedTrace | None:
    """The entry of this content, None if there is none that can be used."""
    try:
        found = json.loads((folder / f"{key}.json").read_text())
        if found["format"] != _FORMAT or (folder / f"{key}.events").stat().st_size != found["bytes"]:
            return None
        return _from_dict(found, folder / f"{key}.events", path, position)
    except (OSError, ValueError, KeyError, TypeError, TraceFormatError):
        return None


def _to_dict(loaded: LoadedTrace) -> dict[str, Any]:
    trace = loaded.trace
    stored = [part.events for part in loaded.parts.values() if isinstance(part.events, StoredEvents)]
    return {
        "format": _FORMAT,
        "bytes": stored[0].file.stat().st_size if stored else 0,
        "sessions": [session.to_json() for session in trace.sessions],
        "runs": [run.to_json() for run in trace.runs],
        "host_samples": [dict(sample) for sample in trace.host_samples],
        "truncated": trace.truncated,
        "ring_events": trace.ring_events,
        "unreadable_messages": trace.unreadable_messages,
        "notes": list(trace.notes),
        "parts": [
            [label[0].value, *label[1:], part.count, part.first_ns, dict(events.columns)]
            for (label, part), events in zip(loaded.parts.items(), stored, strict=True)
        ],
    }


def _from_dict(found: dict[str, Any], file: Path, path: Path, position: int) -> LoadedTrace:
    parts = {}
    for stage, run_id, relay_id, count, first_ns, columns in found["parts"]:
        events = StoredEvents(file, count, {name: (how, value) for name, (how, value) in columns.items()})
        parts[Stage(stage), run_id, relay_id] = EventPart(position, count, first_ns, events)
    trace = Trace(
        path=path,
        sessions=tuple(Session.from_json(text, path) for text in found["sessions"]),
        runs=tuple(Run.from_json(text, path) for text in found["runs"]),
        events={},
        host_samples=tuple(found["host_samples"]),
        truncated=found["truncated"],
        ring_events=found["ring_events"],
        unreadable_messages=found["unreadable_messages"],
        notes=tuple(found["notes"]),
    )
    return LoadedTrace(trace, parts)
