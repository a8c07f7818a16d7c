"""The state of a sweep: `state.json`, valid after any interruption."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from dds_trace.base.errors import UNREADABLE, OptionError, TraceFormatError
from dds_trace.base.files import open_regular
from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.records import from_json, to_json

from ..folder import is_segment_name, replace_text
from ..plan.link import LinkReport
from .outage import OutageReport
from .result import CellResult

STATE_VERSION = 1


class Status(Enum):
    PENDING = "pending"
    RUNNING = "running"  # also of a cell that was interrupted
    RECORDED = "recorded"  # the ping's trace exists, the relay's part is still in the relay's own trace
    COMPLETE = "complete"  # both traces exist
    FAILED = "failed"  # tried as often as the plan allows


@dataclass(frozen=True, slots=True)
class CellState:
    """One cell's entry in the state file, `{}` for None; `run_id` is the run that counts, `further` its other traces."""

    status: Status = Status.PENDING
    attempts: int = 0
    reason: str = ""
    run_id: str = ""
    segment: str = ""
    result: CellResult | None = None
    link: LinkReport | None = None
    outage: OutageReport | None = None
    killed_segment: str = ""
    further: tuple[str, ...] = ()

    def collected(self, segment: str) -> CellState:
        unsplit = replace(
            self,
            segment="" if self.segment == segment else self.segment,
            further=tuple(name for name in self.further if name != segment),
        )
        is_complete = not (unsplit.segment or unsplit.further) and unsplit.status is Status.RECORDED
        return replace(unsplit, status=Status.COMPLETE) if is_complete else unsplit

    @property
    def done(self) -> bool:
        return self.status in (Status.COMPLETE, Status.RECORDED)


class SweepState:
    """The state of one sweep, saved after every change; `planned` cells are for `dds-trace watch`, 0 while it is open."""

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
        self._cells[name] = replace(cell, reason=printable(cell.reason, MAX_FINDING_CHARACTERS))
        self._save()

    def in_segment(self, segment: str) -> dict[str, CellState]:
        return {name: cell for name, cell in self._cells.items() if segment in (cell.segment, *cell.further)}

    def killed_in(self, segment: str) -> dict[str, CellState]:
        return {name: cell for name, cell in self._cells.items() if cell.killed_segment == segment}

    @property
    def segments(self) -> list[str]:
        segments = (
            name for cell in self._cells.values() for name in (cell.killed_segment, cell.segment, *cell.further)
        )
        return list(dict.fromkeys(filter(None, segments)))

    def _load(self) -> None:
        try:
            with open_regular(self.path) as file:
                document = json.load(file)
            version, digest = document["format"], document["plan_digest"]
            self._cells = {
                name: replace(
                    CellState(**cell),
                    status=Status(cell["status"]),
                    result=from_json(CellResult, cell["result"]) if cell["result"] else None,
                    link=cell["link"] or None,
                    outage=cell.get("outage") or None,
                    further=tuple(cell.get("further") or ()),
                )
                for name, cell in document["cells"].items()
            }
            for name, state in self._cells.items():
                _check_names(name, state)
        except UNREADABLE as err:
            raise TraceFormatError(
                self.path, f"not the state of a sweep ({err}); move the folder away to start over"
            ) from err
        if version != STATE_VERSION:
            raise TraceFormatError(
                self.path,
                f"state of format {version}; this version reads {STATE_VERSION}; move the folder away to start over",
            )
        if digest != self._digest:
            raise OptionError(
                f"{self.path.parent}: recorded under other [run], [link] or [devices] settings of the plan "
                f"{self._plan_name!r}; give another --out or name, so that different runs are not mixed"
            )

    def _save(self) -> None:
        cells = {
            name: {key: {} if value is None else value for key, value in to_json(cell).items()}
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
    if not re.fullmatch(r"[\w+-][\w.+-]*", name):
        raise ValueError(f"{name!r} is not the name of a cell")
    for segment in filter(None, (cell.segment, cell.killed_segment, *cell.further)):
        if not is_segment_name(segment):
            raise ValueError(f"{segment!r} is not the name of a relay's trace")
    if cell.run_id and not re.fullmatch(r"[0-9a-f]{1,16}", cell.run_id):
        raise ValueError(f"{cell.run_id!r} is not a run id")
    if bool(cell.segment or cell.further) > bool(cell.run_id):
        raise ValueError(f"{name} has a relay's trace but no run")
