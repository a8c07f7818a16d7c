"""How far the sweeps below a watched folder are, from the state files that they keep."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from dds_trace.analyzer.analysis import Analysis

_STATE, _PARTS = "state.json", ".parts"
"""A sweep's state, and the folder of what it is recording; `recorder/sweep/` writes both."""
_DONE = ("recorded", "complete")


@dataclass(frozen=True, slots=True)
class SweepStatus:
    """Sweeps below a folder, taken together.

    Attributes:
        done: recordings that are there.
        planned: recordings that there will be; 0 where no sweep says so.
        age_s: seconds since the last change of a sweep's state; None without a sweep.
        left_s: about how long the sweeps take from now on.
    """

    done: int = 0
    planned: int = 0
    age_s: float | None = None
    left_s: float = 0.0

    @property
    def running(self) -> bool:
        """Whether recordings are still to come."""
        return self.done < self.planned

    def to_json(self, version: str) -> str:
        """Return the status with the version of the page, as the page asks for it."""
        return json.dumps({"version": version, **asdict(self)})


def sweep_status(folder: Path) -> SweepStatus:
    """Add up the sweeps in and below a folder; a file that is no state of a sweep counts as none."""
    found = SweepStatus()
    for path in sorted(folder.rglob(_STATE)):
        try:
            held, changed_s = json.loads(path.read_text()), path.stat().st_mtime
            done = sum(cell["status"] in _DONE for cell in held["cells"].values())
            planned, left_s = int(held["planned"]), float(held["left_s"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        age_s = max(0.0, time.time() - changed_s)
        found = SweepStatus(
            found.done + done,
            found.planned + planned,
            age_s if found.age_s is None else min(age_s, found.age_s),
            found.left_s + (max(0.0, left_s - age_s) if done < planned else 0.0),
        )
    return found


def without_running(analysis: Analysis) -> Analysis:
    """Return the analysis without findings about the files that a sweep at work has not finished: they end early by nature."""
    unfinished = {source.path for source in analysis.sources if _PARTS in source.path.split("/")}
    kept = [one for one in analysis.findings if not set(one.where.split(", ")) <= unfinished]
    return replace(analysis, findings=tuple(kept))
