"""From a plan to the traces of its cells below a folder."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from dds_trace.base import limits
from dds_trace.base.errors import OptionError, TraceError
from dds_trace.base.files import PLAN_COPY
from dds_trace.base.units import counted
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.base import Meeting

from .folder import TRACE_ENDINGS, locked_folder, log_path, make_parts, remove_files, replace_text, segment_of
from .plan.cells import Cell
from .plan.plan import Plan, depth_warnings
from .plan.schedule import number_groups, schedule, schedule_pass
from .run.progress import SweepProgress
from .run.runner import Runner
from .run.state import Status
from .search import MaxRate, find_max_rates, search_plan
from .station.devices import StartedProgram
from .station.station import Station, open_station

RunIds = Mapping[str, tuple[int, ...]]
MeasureWidths = Callable[[Path, RunIds], Mapping[str, float]]
"""Function from the folder of a sweep and its runs to the half width of each cell's interval."""


TOO_WIDE_EXIT_CODE = 11
"""Exit code of `dds-trace sweep --until`: all is recorded, but some cells are too wide after the last pass."""

DEFAULT_MAX_PASSES = 40
"""Runs with a statistic that spreads by 10 % (standard deviation) need about 33 repeats for +-5 %."""

_TARGET = re.compile(r"\s*(\w+)\s*:\s*([0-9.]+)\s*%\s*")


@dataclass(frozen=True, slots=True)
class Until:
    """The precision at which a sweep ends: `measure` returns each cell's; `max_passes` includes the plan's."""

    statistic: str
    percent: float
    max_passes: int
    measure: MeasureWidths


def parse_target(text: str) -> tuple[str, float]:
    match = _TARGET.fullmatch(text)
    try:
        percent = float(match[2]) if match else 0.0
    except ValueError:
        percent = 0.0
    if match is None or limits.WIDTH_PERCENT.fault(percent) is not None:
        raise OptionError(
            f"--until {limits.shown(text)}: write STATISTIC:PERCENT, for example latency_p99:5%, above 0% and at most "
            f"{limits.WIDTH_PERCENT.high:.0f}%"
        )
    return match[1], percent


@dataclass(frozen=True, slots=True)
class SweepOutcome:
    folder: Path
    cells: int
    missing: dict[str, str]
    too_wide: dict[str, float] = field(default_factory=dict)


@contextmanager
def open_runner(
    plan: Plan, folder: Path, progress: SweepProgress, note: Callable[[str], None], command: Sequence[str] | None
) -> Iterator[Runner]:
    """Lock the folder and open the station of a plan within the block; `command` is `dds-record`, None for the installed one."""
    with locked_folder(folder, note) as lock, open_station(plan, folder, lock, show=note, command=command) as station:
        copy, runner = folder / PLAN_COPY, Runner(plan, folder, station, progress, is_installed_here=command is None)
        if copy.exists() and not runner.state.path.exists():
            note(f"{copy} was there before any sweep: it stays, and the plan is not copied")
        elif plan.text:
            replace_text(copy, plan.text)
        yield runner


def run_sweep(
    plan: Plan, out: Path, progress: SweepProgress, *, command: Sequence[str] | None = None, until: Until | None = None
) -> SweepOutcome:
    """Record the incomplete cells of the plan below `out`, adding passes up to `until`; a `TraceError` if none can be."""
    folder = out / plan.name
    groups = schedule(plan)
    with open_runner(plan, folder, progress, progress.note, command) as runner:
        for warning in depth_warnings(plan):
            progress.note(warning)
        cells = [cell for group in groups for cell in group.cells]
        if plan.relay.ssh is not None and not plan.by_hand and command is None:
            compare_clocks(plan, runner.station, folder, progress.note)
        runner.run(groups)
        too_wide: dict[str, float] = {}
        if until is not None:
            further, too_wide = _run_further_passes(plan, runner, until, progress.note)
            cells += further
        return SweepOutcome(folder, len(cells), runner.reasons(cells), too_wide)


def _run_further_passes(
    plan: Plan, runner: Runner, until: Until, note: Callable[[str], None]
) -> tuple[list[Cell], dict[str, float]]:
    cells: list[Cell] = []
    measured: RunIds = {}
    widths: Mapping[str, float] = {}
    next_group = len(plan.cells) * plan.run.repeats + 1
    number = plan.run.repeats
    while True:
        runs = dict(_complete_runs(plan, runner, until.max_passes))
        if runs != measured:  # equal after a pass that an interrupted sweep had recorded
            measured, widths = runs, until.measure(runner.folder, runs)
        too_wide = {name: widths[name] for name in runs if not widths[name] <= until.percent}
        if not too_wide or number >= until.max_passes:
            return cells, too_wide
        number += 1
        note(
            f"repeat {number}: {until.statistic} of {counted(len(too_wide), 'result is', 'results are')} "
            f"wider than +-{until.percent:g} %"
        )
        wide_cells = [cell for cell in plan.cells if cell.name in too_wide]
        groups = number_groups(schedule_pass(plan, wide_cells, number), next_group)
        next_group += len(groups)
        cells += [cell for group in groups for cell in group.cells]
        runner.run(groups)


def _complete_runs(plan: Plan, runner: Runner, passes: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    for cell in plan.cells:
        states = [runner.state[replace(cell, repeat=number).name] for number in range(1, passes + 1)]
        run_ids = tuple(int(state.run_id, 16) for state in states if state.status is Status.COMPLETE)
        if run_ids:
            yield cell.name, run_ids


def run_search(
    plan: Plan, out: Path, progress: SweepProgress, *, command: Sequence[str] | None = None
) -> tuple[Path, list[MaxRate]]:
    plan = search_plan(plan)
    folder = out / plan.name
    with open_runner(plan, folder, progress, progress.note, command) as runner:
        runner.prepare(plan.cells)
        progress.begin(0, 0)
        try:
            return folder, list(find_max_rates(plan, runner))
        finally:
            progress.end()


SECONDS = 6
TIMEOUT_S = 60.0
SEGMENT, OWN_TRACE = "0-0-0.mcap", "clocks.ping.mcap"
MARK = "your clocks differ"


def compare_clocks(plan: Plan, station: Station, folder: Path, note: Callable[[str], None]) -> None:
    """Note how the devices' clocks differ, on the first backend with discovery; a failure stops no sweep."""
    backends = (cell.backend for cell in plan.cells if not cell.environment)
    backend = next((name for name in backends if load_backend(name).meeting is Meeting.DISCOVERY), None)
    if backend is None:
        return
    words = ["--role", "beacon", "--rate", "5", "--backend", backend, "--domain", str(plan.run.domain)]
    words += ["--discovery", plan.discovery, "--no-own-cost", "--force"]
    out = make_parts(folder) / OWN_TRACE
    names = [host.name or host.ssh or "" for host in plan.hosts] or [""]
    others: dict[str, StartedProgram] = {}
    seen: list[str] = []
    try:
        station.device.prepare()
        try:
            for number, name in enumerate(names):
                device_option = ["--device", name] if name else []
                segment = segment_of(SEGMENT, number + 1, number)
                long = [*words, *device_option, "--duration", str(int(TIMEOUT_S))]
                others[segment] = station.device.start(long, segment)
            command = [*station.ping_command, *words, "--duration", str(SECONDS), "--out", str(out)]
            ended = subprocess.run(
                command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, errors="replace"
            )
        finally:
            for other in others.values():
                other.stop()
            for number, segment in enumerate(others, 1):
                log = log_path(out.parent, segment)
                latest = _latest(log.read_text(errors="replace")) if len(names) > 1 else {}
                seen += [f"seen from {names[number - 1]}: {latest[name]}" for name in names[number:] if name in latest]
                station.device.discard(segment)
            remove_files(out.parent, OWN_TRACE, TRACE_ENDINGS)
    except (TraceError, OSError, subprocess.TimeoutExpired) as error:
        note(f"the clocks of both devices were not compared: {error}")
        return
    lines = _latest(ended.stderr)
    last = (ended.stderr.splitlines() or ["no answer"])[-1]
    for line in [*lines.values(), *seen] or [f"the clocks of both devices were not compared: {last}"]:
        note(line)
    for name in names:
        if name and lines and name not in lines:
            note(f"{name}: its clock was not compared; its beacon did not answer")


def _latest(text: str) -> dict[str, str]:
    return {line.partition(":")[0].split()[-1]: line for line in text.splitlines() if MARK in line}
