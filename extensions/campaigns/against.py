"""Two plans interleaved: base, new, new, base ... each in a folder of its own (docs/how-to/sweep.md)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted

from .plan.cells import Cell
from .plan.plan import Plan, depth_warnings
from .plan.schedule import CellGroup, Remaining, group_by_relay, plan_seconds, schedule_pass
from .run.progress import SweepProgress
from .sweep import SweepOutcome, open_runner

BASE, NEW = "base", "new"


@dataclass(frozen=True, slots=True)
class InterleavedRun:
    side: str
    group: CellGroup


@dataclass(frozen=True, slots=True)
class AgainstOutcome:
    folder: Path
    base: SweepOutcome
    new: SweepOutcome


def interleave(base: Plan, new: Plan, repeats: Mapping[int, Sequence[Cell]] | None = None) -> list[InterleavedRun]:
    """Return both sides' cells in the base's order; of each base, new, new, base ... by repeat: drifts cancel."""
    if len(base.cells) != len(new.cells):
        raise OptionError(
            f"the base has {counted(len(base.cells), 'result')} and the new side {len(new.cells)}; "
            "give plans with the same number of results, in the same order"
        )
    indices = {cell.name: index for index, cell in enumerate(base.cells)}
    runs = []
    for number, cells in (repeats or dict.fromkeys(range(1, base.run.repeats + 1), base.cells)).items():
        for group in schedule_pass(base, cells, number):
            for cell in group.cells:
                index = indices[replace(cell, repeat=1).name]
                pair = [(BASE, base, cell), (NEW, new, replace(new.cells[index], repeat=number))]
                for side, plan, item in pair if (index + number) % 2 else reversed(pair):
                    runs += [InterleavedRun(side, single) for single in group_by_relay(plan, [item])]
    return [replace(run, group=replace(run.group, number=number)) for number, run in enumerate(runs, start=1)]


def against_seconds(base: Plan, new: Plan) -> Remaining:
    repeats = base.run.repeats
    sides = (plan_seconds(side, passes=repeats, relay_starts=repeats * len(side.cells)) for side in (base, new))
    return Remaining(sum(side.seconds for side in sides))


def run_against(
    base: Plan,
    new: Plan,
    folder: Path,
    progress: SweepProgress,
    *,
    commands: tuple[Sequence[str] | None, Sequence[str] | None] = (None, None),
    busier: Callable[[Path, Path], Iterable[tuple[str, int]]] = lambda _, __: (),
) -> AgainstOutcome:
    """Record every cell of both sides, interleaved, in the folders `base` and `new`; order and repeats are the base's.

    `busier` returns, by cell of the base, repeats in which the machine was busier on one side: they are recorded again, once.
    `commands` are the `dds-record` of each side, None for the installed one.
    """
    runs = interleave(base, new)
    partners = {new_cell.name: base_cell.name for new_cell, base_cell in zip(new.cells, base.cells, strict=True)}
    plans = {BASE: base, NEW: replace(new, partners=partners)}
    cells: dict[str, list[Cell]] = {BASE: [], NEW: []}
    with ExitStack() as stack:
        runners = {}
        for (side, plan), command in zip(plans.items(), commands, strict=True):
            opened = open_runner(plan, folder / side, _SideProgress(progress, side), progress.note, command)
            runners[side] = stack.enter_context(opened)
        for warning in dict.fromkeys([*depth_warnings(base), *depth_warnings(new)]):
            progress.note(warning)

        def record(turns: Sequence[InterleavedRun]) -> None:
            for turn in turns:
                cells[turn.side].append(turn.group.cells[0])
            complete = sum(runner.prepare(cells[side]) for side, runner in runners.items())
            progress.begin(sum(map(len, cells.values())), complete)
            try:
                for turn in turns:
                    runners[turn.side].run_group(turn.group, cells[turn.side])
            finally:
                progress.end()

        record(runs)
        is_recorded = all(len(runner.reasons(cells[side])) < len(cells[side]) for side, runner in runners.items())
        repeated = busier(folder / BASE, folder / NEW) if is_recorded else ()
        counts = Counter(name for name, number in repeated if number <= base.run.repeats)
        if counts:
            again = counted(counts.total(), "repeat is", "repeats are")
            progress.note(f"the machine was busier on one side: {again} recorded again, and these not judged")
            further = {
                base.run.repeats + number: [cell for cell in base.cells if counts[cell.name] >= number]
                for number in range(1, max(counts.values()) + 1)
            }
            record(interleave(base, new, further))
        outcomes = [SweepOutcome(folder / side, len(cells[side]), runners[side].reasons(cells[side])) for side in plans]
    return AgainstOutcome(folder, *outcomes)


class _SideProgress(SweepProgress):
    def __init__(self, progress: SweepProgress, side: str) -> None:
        self._progress = progress
        self._side = side

    def relay(self, name: str) -> None:
        self._progress.relay(f"{self._side} {name}")

    def cell(self, name: str, remaining: Remaining) -> None:
        self._progress.cell(f"{self._side} {name}", Remaining(2 * remaining.seconds))

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        self._progress.ended(f"{self._side} {name}", outcome, complete=complete)

    def note(self, text: str) -> None:
        self._progress.note(f"{self._side}: {text}")
