"""The state of a sweep: `state.json`, replaced as a whole so that any interruption leaves a valid file."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError, TraceFormatError
from dds_trace.base.files import create_file, output_error, replacing

from ..station.devices import is_segment_name
from .result import CellResult

if TYPE_CHECKING:
    from pathlib import Path

    from ..plan.link import LinkReport

STATE_VERSION = 1
"""Version 1: first version (2026)."""


class Status(Enum):
    """Progress of one cell."""

    PENDING = "pending"  # not begun
    RUNNING = "running"  # begun; in a state file that no sweep works on, it was interrupted
    RECORDED = "recorded"  # the ping's trace is there, the relay's part is still in the relay's own trace
    COMPLETE = "complete"  # both traces are there
    FAILED = "failed"  # tried as often as the plan allows; `reason` says why it failed


@dataclass(frozen=True, slots=True)
class CellState:
    """One cell's entry in the state file.

    Attributes:
        attempts: number of runs that were begun.
        reason: reason of the last failure; empty without one.
        run_id: the run that counts, 16 hex digits; empty before there is one.
        segment: name of the relay's own trace that still holds this cell's part; empty once it is taken out.
        result: numbers of the ping's trace; None before there are any. The file has `{}` for None.
        link: report of the emulated link for the run; None without such a link, `{}` in the file.
    """

    status: Status = Status.PENDING
    attempts: int = 0
    reason: str = ""
    run_id: str = ""
    segment: str = ""
    result: CellResult | None = None
    link: LinkReport | None = None

    @property
    def done(self) -> bool:
        """Whether the cell needs no further run."""
        return self.status in (Status.COMPLETE, Status.RECORDED)


class SweepState:
    """The state of one sweep, saved after every change.

    Args:
        path: path of the state file; its folder exists.
        plan_name: name of the plan, for the file and for errors.
        digest: digest of the plan's settings; a file of another digest is refused.

    Attributes:
        planned: number of cells of the sweep, for `dds-analyze watch`; 0 where it is not known.
        left_s: estimate of the time that is left, as of the last change of the file.

    Raises:
        TraceFormatError: the file is not a state of this version.
        OptionError: it belongs to a plan that records the same cells differently.
    """

    def __init__(self, path: Path, plan_name: str, digest: str) -> None:
        self.path = path
        self._plan_name = plan_name
        self._digest = digest
        self._cells: dict[str, CellState] = {}
        self.planned = 0
        self.left_s = 0.0
        if path.exists():
            self._load()

    def __getitem__(self, name: str) -> CellState:
        return self._cells.get(name, CellState())

    def __setitem__(self, name: str, cell: CellState) -> None:
        self._cells[name] = cell
        self._save()

    def in_segment(self, segment: str) -> dict[str, CellState]:
        """Return the cells whose relay's part is still in this segment, by name."""
        return {name: cell for name, cell in self._cells.items() if cell.segment == segment}

    @property
    def segments(self) -> list[str]:
        """Names of the relay traces that still hold parts of cells, oldest first."""
        return list(dict.fromkeys(cell.segment for cell in self._cells.values() if cell.segment))

    def _load(self) -> None:
        try:
            held = json.loads(self.path.read_text())
            version, digest = held["format"], held["plan_digest"]
            self._cells = {
                name: replace(
                    CellState(**cell),
                    status=Status(cell["status"]),
                    result=CellResult(**cell["result"]) if cell["result"] else None,
                    link=cell["link"] or None,
                )
                for name, cell in held["cells"].items()
            }
            for name, state in self._cells.items():
                _check_names(name, state)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
            raise TraceFormatError(
                self.path,
                f"not the state of a sweep ({err}); move the folder away to begin anew",
            ) from err
        if version != STATE_VERSION:
            raise TraceFormatError(
                self.path,
                f"state of format {version}; this version reads {STATE_VERSION}; move the folder away to begin anew",
            )
        if digest != self._digest:
            raise OptionError(
                f"{self.path.parent}: recorded under other [run], [link] or [devices] settings of the plan "
                f"{self._plan_name!r}; give another --out or name, so that unlike runs are not mixed",
            )

    def _save(self) -> None:
        cells = {
            name: {
                **asdict(cell),
                "status": cell.status.value,
                "result": asdict(cell.result) if cell.result else {},
                "link": cell.link or {},
            }
            for name, cell in self._cells.items()
        }
        document = {
            "format": STATE_VERSION,
            "plan": self._plan_name,
            "plan_digest": self._digest,
            "planned": self.planned,
            "left_s": round(self.left_s),
            "cells": cells,
        }
        replace_text(self.path, json.dumps(document, indent=1))


def _check_names(name: str, cell: CellState) -> None:
    """Check what becomes part of a path: a state file may come with a folder from somebody else.

    Raises:
        ValueError: a name is none that a sweep gives.
    """
    if not re.fullmatch(r"[\w+-][\w.+-]*", name):
        raise ValueError(f"{name!r} is no name of a cell")
    if cell.segment and not is_segment_name(cell.segment):
        raise ValueError(f"{cell.segment!r} is no name of a relay's trace")
    if cell.run_id and not re.fullmatch(r"[0-9a-f]{1,16}", cell.run_id):
        raise ValueError(f"{cell.run_id!r} is no run id")
    if bool(cell.segment) > bool(cell.run_id):
        raise ValueError(f"{name} has a relay's trace and no run")


def replace_text(path: Path, text: str) -> None:
    """Replace a file so that a reader, or a reboot, finds either the old text or the new one.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        with replacing(path, fsync=True) as draft, create_file(draft) as file:
            file.write(text.encode())
    except OSError as err:
        raise output_error(path, err, "the state of the sweep") from err
