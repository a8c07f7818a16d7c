"""Traces without their events, which wait in a folder of temporary files until they are paired."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import BinaryIO

from dds_trace.base.errors import OutputError, TraceFormatError
from dds_trace.base.extension import load as load_part
from dds_trace.tracefile.format.events import EventColumns, Stage
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import read_trace_in_pieces
from dds_trace.tracefile.reading.trace import Trace

from .event_index import EventKey, EventPart, split_trace
from .place import is_remote
from .spool import SpooledEvents, SpooledPiece, TemporaryFolder, write_events

Stamp = tuple[object, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrace:
    trace: Trace
    parts: Mapping[EventKey, EventPart]
    file: Path

    @property
    def events(self) -> int:
        return sum(part.count for part in self.parts.values())

    def at(self, position: int) -> LoadedTrace:
        return replace(self, parts={key: replace(part, trace=position) for key, part in self.parts.items()})


LoadAll = Callable[[Sequence[Path]], Iterator[LoadedTrace | TraceFormatError]]
"""Yields each trace, or why a file is not one."""


MOST_EVENTS_IN_MEMORY = 500_000
"""Events that are not written and read again: 28 MB."""


class TraceSpool:
    """Loads traces into a folder of temporary files; used again, it reads only those that changed."""

    def __init__(self) -> None:
        self._folder = TemporaryFolder()
        self._loaded: dict[Stamp, LoadedTrace] = {}

    @property
    def folder(self) -> Path:
        return self._folder.path

    def room(self) -> int:
        parts = (part for loaded in self._loaded.values() for part in loaded.parts.values())
        return max(0, MOST_EVENTS_IN_MEMORY - sum(p.count for p in parts if isinstance(p.events, EventColumns)))

    def load_all(self, paths: Sequence[Path], load_new: LoadAll) -> Iterator[LoadedTrace | TraceFormatError]:
        """Yield each trace, or why a file is not one; `load_new` loads those that are not here yet."""
        stamps = {path: _stamp_of(path) for path in paths}
        for stamp in self._loaded.keys() - set(stamps.values()):
            self._loaded.pop(stamp).file.unlink(missing_ok=True)
        loads = load_new([path for path, stamp in stamps.items() if stamp not in self._loaded])
        for stamp in stamps.values():
            loaded = self._loaded.get(stamp) or next(loads)
            if isinstance(loaded, LoadedTrace):
                self._loaded[stamp] = loaded
            yield loaded

    def close(self) -> None:
        self._folder.remove()


def load(path: Path, folder: Path, room: int = 0) -> LoadedTrace | TraceFormatError:
    """Load one trace, its events into a file of `folder` for other processes; one piece with `room` stays in memory."""
    file = folder / f"{secrets.token_hex(8)}.events"
    in_memory: list[Mapping[Stage, EventColumns]] = []
    written: dict[EventKey, list[tuple[int, int, SpooledPiece]]] = {}
    try:
        with ExitStack() as opened:
            stream: BinaryIO | None = None

            def take(piece: Mapping[Stage, EventColumns]) -> None:
                nonlocal stream
                in_memory.append(piece)
                if not written and len(in_memory) == 1 and sum(map(len, piece.values())) <= room:
                    return
                for key, part in chain.from_iterable(split_trace(events, 0).items() for events in in_memory):
                    try:
                        stream = stream or opened.enter_context(file.open("wb"))
                        spooled = write_events(stream, part.load())
                    except OSError as err:  # not of reading the trace
                        raise _full(path, err) from err
                    written.setdefault(key, []).append((part.first_ns, part.last_ns, spooled))
                in_memory.clear()

            trace = _read(path, take)
    except TraceFormatError as err:
        file.unlink(missing_ok=True)
        return err
    except OSError as err:
        raise _full(path, err) from err
    parts = split_trace(in_memory[0], 0) if in_memory else {}
    for key, pieces in written.items():
        firsts_ns, lasts_ns, spooled = zip(*pieces, strict=True)
        events = SpooledEvents(file, spooled)
        parts[key] = EventPart(0, events.count, min(firsts_ns), max(lasts_ns), events)
    return LoadedTrace(trace, parts, file)


def load_some(paths: Sequence[Path], folder: Path) -> list[LoadedTrace | TraceFormatError]:
    return [load(path, folder) for path in paths]


def _read(path: Path, take: Callable[[Mapping[Stage, EventColumns]], object]) -> Trace:
    """Read one trace, without its events, which `take` gets piece by piece; an empty one is a `TraceFormatError`, too."""
    has_events = False

    def take_and_note(piece: Mapping[Stage, EventColumns]) -> None:
        nonlocal has_events
        has_events = has_events or any(map(len, piece.values()))
        take(piece)

    with load_part("parts", "copy_remote")(path) if is_remote(path) else nullcontext(path) as local:
        try:
            trace = replace(read_trace_in_pieces(local, take_and_note), path=path)
        except OSError as err:
            raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
        except TraceFormatError as err:
            raise TraceFormatError(path, err.what) from err
    if not (trace.sessions or trace.runs or has_events):
        raise TraceFormatError(path, f"contains nothing of a trace ({trace.truncated or 'it is complete'})")
    return trace


def _full(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"events of {path} cannot be written to a temporary file ({error}); give a larger folder with TMPDIR"
    )


def _stamp_of(path: Path) -> Stamp:
    """Return what a trace is known by: its path, and size and time of change of each of its files."""
    if is_remote(path):
        return (path, object())  # never equal to another
    stamp: list[object] = [path]
    for file in sorted(path.iterdir()) if path.is_dir() else [path, ring_path(path)]:
        with suppress(OSError):
            status = file.stat()
            stamp += [file.name, status.st_size, status.st_mtime_ns]
    return tuple(stamp)
