"""Where a recording goes and what remains of it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from dds_trace.base.errors import OutputError, OutputExistsError
from dds_trace.base.files import OWNER_AND_GROUP, flush_to_disk, output_error

from ..format.bag_metadata import METADATA_NAME
from ..format.ring import is_recorded, ring_path


@dataclass(frozen=True, slots=True)
class TraceDestination:
    """Destination of a trace, and how it is written.

    Attributes:
        path: a `.mcap` file; any other name is a rosbag2 folder NAME with NAME/NAME_0.mcap and its metadata.
        ring_slots: events (64 bytes each) in the ring before further ones are dropped.
        mode: the most rights of trace, ring and metadata; the umask may reduce them.
    """

    path: Path
    force: bool = False
    fsync: bool = False
    chunk_seconds: float = 1.0
    ring_slots: int = 1 << 16
    mode: int = OWNER_AND_GROUP

    @property
    def flush_seconds(self) -> float:
        return self.chunk_seconds / 2 if self.fsync else self.chunk_seconds

    @property
    def is_bag(self) -> bool:
        return self.path.suffix != ".mcap"

    @property
    def trace_path(self) -> Path:
        return self.path / f"{self.path.name}_0.mcap" if self.is_bag else self.path


@dataclass(frozen=True, slots=True)
class ClosedTrace:
    """Result of a recording; `error` is why writing failed and left `ring_events` to readers and `recover`."""

    path: Path
    events: int
    dropped_events: int
    bytes: int
    error: OutputError | None
    ring_events: int = 0


def discard(destination: TraceDestination) -> None:
    """Remove a closed trace, so that the next recording can use its name."""
    try:
        for path in _files_of(destination):
            path.unlink(missing_ok=True)
        if destination.is_bag:
            destination.path.rmdir()
    except OSError as err:
        raise output_error(destination.path, err) from err


def _files_of(destination: TraceDestination) -> list[Path]:
    trace = destination.trace_path
    files = [trace, ring_path(trace)]
    return [*files, trace.with_name(METADATA_NAME)] if destination.is_bag else files


def make_room(destination: TraceDestination) -> None:
    """Create the folder of the trace; refuse existing files of the same names, or remove them with `force`."""
    ours = _files_of(destination)
    existing = [path for path in (destination.path, *ours) if os.path.lexists(path)]  # a dangling link too
    if existing and not destination.force:
        raise OutputExistsError(f"{existing[0]} is there already; choose another name or use --force")
    if is_recorded(destination.trace_path):
        raise OutputExistsError(f"{destination.path} is still being recorded; choose another name or stop its recorder")
    try:
        for path in ours:
            path.unlink(missing_ok=True)
        _make_folder(destination.trace_path.parent, destination)
    except OSError as err:
        raise output_error(destination.path, err) from err


def _make_folder(folder: Path, destination: TraceDestination) -> None:
    """Create a folder and its parents; a bag's own folder admits nobody who may not read the trace."""
    if folder.is_dir():
        return
    _make_folder(folder.parent, destination)
    readers = destination.mode & 0o444
    rights = destination.mode | readers >> 2 if folder == destination.path else 0o777
    folder.mkdir(rights, exist_ok=True)
    if destination.fsync:
        flush_to_disk(folder.parent)
