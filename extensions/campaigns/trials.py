"""Runs of candidates in one folder, as the search asks for them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from statistics import fmean

import numpy as np

from dds_trace.base.errors import TraceError

from .folder import locked_folder
from .halving import Candidate, Look, Measurer
from .plan.cells import Cell
from .plan.flows import recorded_together
from .plan.plan import Plan
from .plan.schedule import RELAY_OVERHEAD_S, Estimate, group_by_relay
from .run.progress import SweepProgress
from .run.result import read_cpu_percent, read_responses
from .run.runner import Runner
from .run.state import Status
from .station.station import open_station

CUTOFF_S, SETTLE_S = 5.0, 0.2

SSH_OVERHEAD_S = 4.0
"""Start of a relay by ssh, and transfer of its trace."""


def plan_of_trials(plan: Plan, seconds: float) -> Plan:
    """Return the plan with runs of such a length, without a measurement of the recorder's own cost after the first repeat."""
    run = replace(
        plan.run,
        messages=0,
        seconds=seconds,
        min_messages=12,
        warmup=5,
        settle_seconds=SETTLE_S,
        cutoff_seconds=CUTOFF_S,
        own_cost_passes=1,
    )
    return replace(plan, run=run)


@dataclass(slots=True)
class Durations:
    """How long runs of a plan take: by the plan's estimate, then with the start and end of the runs so far, by candidate."""

    plan: Plan
    overheads_s: dict[str, list[float]] = field(default_factory=dict)

    def expected_s(self, candidate: Candidate, seconds: float) -> float:
        """Return the duration of a run with its start and end; the mean of all candidates counts as one run more of this one."""
        plan = plan_of_trials(self.plan, seconds)
        if self.overheads_s:
            own_s = self.overheads_s.get(candidate.name, [])
            mean_s = fmean(chain.from_iterable(self.overheads_s.values()))
            return self._planned_s(candidate, seconds) + fmean([mean_s, *own_s])
        cells = [replace(cell, repeat=2) for cell in candidate.cells]
        overhead_s = RELAY_OVERHEAD_S + SSH_OVERHEAD_S * plan.has_two_devices
        return Estimate(plan).remaining(cells).seconds + overhead_s

    def took(self, candidate: Candidate, seconds: float, elapsed_s: float) -> None:
        self.overheads_s.setdefault(candidate.name, []).append(elapsed_s - self._planned_s(candidate, seconds))

    def _planned_s(self, candidate: Candidate, seconds: float) -> float:
        run = plan_of_trials(self.plan, seconds).run
        recordings = recorded_together(candidate.cells)
        return sum(max(run.planned_seconds(cell.rate) for cell in cells) for cells in recordings)


@dataclass(slots=True)
class Imagined(Durations):
    """A `Measurer` that records nothing and lets its own time pass."""

    now_s: float = 0.0
    recordings: int = 0
    _numbers: dict[str, int] = field(default_factory=dict)

    @contextmanager
    def open(self, *_: object) -> Iterator[Measurer]:
        yield self

    def look(self, candidate: Candidate, _: int, seconds: float) -> Look:
        self.now_s += self.expected_s(candidate, seconds)
        self.recordings += len(candidate.cells)
        number = self._numbers.setdefault(candidate.name, len(self._numbers))
        return Look(tuple(np.full(100, 1.01**number) for _ in candidate.cells))


@dataclass(slots=True, kw_only=True)
class Trials(Durations):
    """A `Measurer` that records; a run that an interrupted search recorded is not recorded again."""

    runner: Runner

    def look(self, candidate: Candidate, number: int, seconds: float) -> Look:
        began_s = time.monotonic()
        # The first repeat would measure the recorder's own cost.
        cells = [replace(cell, repeat=number + 1) for cell in candidate.cells]
        is_new = not all(self.runner.state[cell.name].done for cell in cells)
        failure = self.record(cells, seconds)
        if is_new:
            self.took(candidate, seconds, time.monotonic() - began_s)
        if failure:
            return Look(failure=failure)
        paths = [self.paths(cell) for cell in cells]
        try:
            responses = tuple(read_responses(ping) for ping, _ in paths)
            return Look(responses, max(read_cpu_percent(path) for pair in paths for path in pair if path.exists()))
        except (TraceError, OSError) as err:
            return Look(failure=str(err))

    def record(self, cells: Sequence[Cell], seconds: float) -> str:
        """Record each cell with a relay of its own settings; return why one could not be."""
        self.runner.plan = plan_of_trials(self.runner.plan, seconds)
        for group in group_by_relay(self.runner.plan, cells):
            waiting = [
                together
                for together in recorded_together(group.cells)
                if not all(self.runner.state[cell.name].done for cell in together)
            ]
            if not waiting:
                continue
            with self.runner.relay(group) as relay:
                for together in waiting:
                    self.runner.record_together(together, relay)
                    for state in (self.runner.state[cell.name] for cell in together):
                        if state.status is Status.FAILED:
                            return state.reason
                        if state.result is not None and state.result.not_applied:
                            return f"not applied: {state.result.not_applied}"
        return ""

    def paths(self, cell: Cell) -> tuple[Path, Path]:
        """Return the traces of the ping and of the relay."""
        return self.runner.folder / f"{cell.name}.ping.mcap", self.runner.relay_path(cell.name)


class Notes(SweepProgress):
    """What a runner remarks."""

    def __init__(self, note: Callable[[str], None]) -> None:
        self._note = note

    def note(self, text: str) -> None:
        self._note(text)


@contextmanager
def open_trials(
    plan: Plan,
    folder: Path,
    note: Callable[[str], None],
    seconds: float,
    overheads_s: dict[str, list[float]] | None = None,
) -> Iterator[Trials]:
    """Lock the folder and open the station of a plan within the block; `seconds` is the length that its state is for.

    `overheads_s` has the overheads of earlier runs, and gets further ones.
    """
    plan = plan_of_trials(plan, seconds)
    with locked_folder(folder, note) as lock, open_station(plan, folder, lock, show=note) as station:
        runner = Runner(plan, folder, station, Notes(note))
        runner.prepare(plan.cells)
        yield Trials(plan, {} if overheads_s is None else overheads_s, runner=runner)
