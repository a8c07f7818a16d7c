"""Read one trace and index its events, in memory or piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from sys import getsizeof

from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.format.events import EventColumns, Stage
from dds_trace.tracefile.reading.reader import read_trace, read_trace_in_pieces
from dds_trace.tracefile.reading.trace import Trace

from .event_index import EventKey, EventPart, split_trace
from .remote import local_copy


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrace:
    """A trace without its events, and their index."""

    trace: Trace
    parts: Mapping[EventKey, EventPart]

    def __sizeof__(self) -> int:
        return object.__sizeof__(self) + sum(map(getsizeof, self.parts.values()))

    @property
    def events(self) -> int:
        return sum(part.count for part in self.parts.values())

    def at(self, position: int) -> LoadedTrace:
        return LoadedTrace(self.trace, {label: replace(part, trace=position) for label, part in self.parts.items()})


def load_trace(path: Path, position: int) -> LoadedTrace:
    """Read one trace, events in memory.

    Raises:
        TraceFormatError: it is not a trace, cannot be read, or is empty.
    """
    trace = _read(path, read_trace)
    _check_is_not_empty(trace, trace.event_count)
    return LoadedTrace(replace(trace, events={}), split_trace(trace.events, position))


def read_in_pieces(path: Path, take: Callable[[Mapping[Stage, EventColumns]], object]) -> Trace:
    """Read one trace, returned without its events, which `take` gets piece by piece; as `load_trace`."""
    events = 0

    def take_and_count(piece: Mapping[Stage, EventColumns]) -> None:
        nonlocal events
        events += sum(map(len, piece.values()))
        take(piece)

    trace = _read(path, lambda local: read_trace_in_pieces(local, take_and_count))
    _check_is_not_empty(trace, events)
    return trace


def loaded_or_error(
    load: Callable[[Path, int], LoadedTrace], path: Path, position: int
) -> LoadedTrace | TraceFormatError:
    try:
        return load(path, position)
    except TraceFormatError as err:
        return err


def _read(path: Path, read: Callable[[Path], Trace]) -> Trace:
    with local_copy(path) as local:
        try:
            return replace(read(local), path=path)
        except OSError as err:
            raise TraceFormatError(path, f"cannot be read ({err.strerror})") from err
        except TraceFormatError as err:
            raise TraceFormatError(path, err.what) from err


def _check_is_not_empty(trace: Trace, events: int) -> None:
    if not (trace.sessions or trace.runs or events):
        raise TraceFormatError(trace.path, f"contains nothing of a trace ({trace.truncated or 'it is complete'})")
