"""What a sweep has done so far: `state.json`, replaced as a whole so that any interruption leaves a valid one."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import OptionError, OutputError, TraceFormatError
from dds_trace.tracefile.files import replacing

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

STATE_VERSION = 1
"""Version 1: first version (2026)."""


class Status(Enum):
    """How far a cell is."""

    PENDING = "pending"  # not begun
    RUNNING = "running"  # begun; found in a state file that nobody works on, it was interrupted
    RECORDED = "recorded"  # the ping's trace is there, the relay's part is still in the relay's own trace
    COMPLETE = "complete"  # both traces are there
    FAILED = "failed"  # tried as often as the plan allows; `reason` says why it failed


@dataclass(frozen=True, slots=True)
class CellState:
    """One cell's line in the state file.

    Attributes:
        attempts: runs that were begun.
        reason: why it failed last; empty if it did not.
        run_id: of the run that counts, 16 hex digits; empty before there is one.
        segment: the relay's own trace that still holds the relay's part of it; empty when it is taken out.
        result: what the ping's trace says (`CellResult`), for progress and later readers.
        link: what the emulated link did during the run (`NamespacePair.measure`), empty without one.
    """

    status: Status = Status.PENDING
    attempts: int = 0
    reason: str = ""
    run_id: str = ""
    segment: str = ""
    result: Mapping[str, Any] = field(default_factory=dict)
    link: Mapping[str, Any] = field(default_factory=dict)

    @property
    def done(self) -> bool:
        """Whether nothing is left to be run for it."""
        return self.status in (Status.COMPLETE, Status.RECORDED)


class SweepState:
    """The state of one sweep, saved after every change.

    Args:
        path: of the state file; its folder exists.
        digest: of the plan; recorded cells keep to it.

    Raises:
        TraceFormatError: the file is none of ours.
        OptionError: it belongs to a plan that records the same cells differently.
    """

    def __init__(self, path: Path, plan_name: str, digest: str) -> None:
        self.path = path
        self._plan_name = plan_name
        self._digest = digest
        self._cells: dict[str, CellState] = {}
        if path.exists():
            self._load()

    def __getitem__(self, name: str) -> CellState:
        return self._cells.get(name, CellState())

    def update(self, name: str, **changes: Any) -> CellState:
        """Changes fields of a cell, saves the state and gives the cell's new state."""
        self._cells[name] = replace(self[name], **changes)
        self._save()
        return self._cells[name]

    def update_all(self, names: Iterable[str], **changes: Any) -> None:
        """Changes fields of several cells at once."""
        for name in names:
            self._cells[name] = replace(self[name], **changes)
        self._save()

    def in_segment(self, segment: str) -> dict[str, CellState]:
        """The cells whose relay's part is still in this segment."""
        return {name: cell for name, cell in self._cells.items() if cell.segment == segment}

    @property
    def segments(self) -> list[str]:
        """Relay traces that still hold parts of cells, oldest first."""
        return list(dict.fromkeys(cell.segment for cell in self._cells.values() if cell.segment))

    def _load(self) -> None:
        try:
            held = json.loads(self.path.read_text())
            version, digest = held["format"], held["plan_digest"]
            self._cells = {
                name: CellState(**{**cell, "status": Status(cell["status"])})
                for name, cell in held["cells"].items()
            }
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
            raise TraceFormatError(
                self.path,
                f"not the state of a sweep ({err}); move the folder away to begin anew",
            ) from err
        if version != STATE_VERSION:
            raise TraceFormatError(
                self.path, f"state of format {version}; this version reads {STATE_VERSION}"
            )
        if digest != self._digest:
            raise OptionError(
                f"{self.path.parent}: recorded under other [run], [link] or [devices] settings of the plan "
                f"{self._plan_name!r}; give another --out or name, so that unlike runs are not mixed",
            )

    def _save(self) -> None:
        text = json.dumps(
            {
                "format": STATE_VERSION,
                "plan": self._plan_name,
                "plan_digest": self._digest,
                "cells": {
                    name: {**asdict(cell), "status": cell.status.value} for name, cell in self._cells.items()
                },
            },
            indent=1,
        )
        write_atomically(self.path, text)


def write_atomically(path: Path, text: str) -> None:
    """Replaces a file so that a reader, or a reboot, finds either the old text or the new one.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        with replacing(path, fsync=True) as draft:
            draft.write_text(text)
    except OSError as err:
        raise OutputError(
            f"{path}: {err.strerror}; free some space or give another --out, then run it again"
        ) from err
