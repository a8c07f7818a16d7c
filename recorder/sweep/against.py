"""Two sides measured in turns: base, new, new, base ... each in a folder of its own.

What two folders that were recorded one after the other differ by is first of all the time between them. In turns both
sides meet the same machine, and pass by pass they can be compared as pairs.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted

from .plan.plan import depth_warnings
from .plan.schedule import CellGroup, Remaining, group_by_relay, plan_seconds, schedule_pass
from .run.lock import holding_folder
from .run.runner import Runner
from .station.station import open_station
from .sweep import SweepOutcome

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .plan.plan import Plan
    from .run.progress import SweepProgress

BASE, NEW = "base", "new"
"""Names of the two sides and of their folders."""


@dataclass(frozen=True, slots=True)
class Turn:
    """One cell of one side.

    Attributes:
        side: `base` or `new`.
        group: the cell alone, with its relay.
    """

    side: str
    group: CellGroup


@dataclass(frozen=True, slots=True)
class AgainstOutcome:
    """Result of a sweep of two sides.

    Attributes:
        folder: folder with the folders of the sides.
        base: result of the base.
        new: result of the new side.
    """

    folder: Path
    base: SweepOutcome
    new: SweepOutcome


def take_turns(base: Plan, new: Plan) -> list[Turn]:
    """Return every cell of both sides in the order of the base's plan; of each cell base, new, new, base ... by pass.

    The two runs of a cell follow each other at once, and the side that begins alternates: a linear drift cancels over
    two passes, and so does what the first run of a pair leaves to the second. Each run has a relay of its own.

    Raises:
        OptionError: the plans have not as many cells.
    """
    if len(base.cells) != len(new.cells):
        raise OptionError(
            f"the base has {counted(len(base.cells), 'cell')} and the new side {len(new.cells)}; "
            "give plans whose cells stand in the same order, one for one"
        )
    partners = {cell.name: place for place, cell in enumerate(base.cells)}
    turns = []
    for number in range(1, base.run.repeats + 1):
        for group in schedule_pass(base, base.cells, number):
            for cell in group.cells:
                place = partners[replace(cell, repeat=1).name]
                both = [(BASE, base, cell), (NEW, new, replace(new.cells[place], repeat=number))]
                for side, plan, one in both if (place + number) % 2 else reversed(both):
                    turns += [Turn(side, alone) for alone in group_by_relay(plan, [one])]
    return [
        replace(turn, group=replace(turn.group, number=number)) for number, turn in enumerate(turns, start=1)
    ]


def against_seconds(base: Plan, new: Plan) -> Remaining:
    """Return the expected time of both sides."""
    alone = len(base.cells) * base.run.repeats
    both = [plan_seconds(side, passes=base.run.repeats, relay_starts=alone).seconds for side in (base, new)]
    return Remaining(sum(both))


def run_against(
    base: Plan,
    new: Plan,
    folder: Path,
    progress: SweepProgress,
    *,
    commands: tuple[Sequence[str] | None, Sequence[str] | None] = (None, None),
) -> AgainstOutcome:
    """Record every cell of both sides in turns.

    Args:
        base: plan of the base; its order and number of passes are those of both.
        new: plan of the new side.
        folder: folder in which the sides' folders `base` and `new` are made.
        progress: receiver of every step.
        commands: `dds-record` of each side; the installed one for None.

    Raises:
        TraceError: no cell can be recorded at all; failures of single cells are in the outcome.
    """
    turns = take_turns(base, new)
    partners = {own.name: of_base.name for own, of_base in zip(new.cells, base.cells, strict=True)}
    new = replace(new, partners=partners)
    cells = {side: [turn.group.cells[0] for turn in turns if turn.side == side] for side in (BASE, NEW)}
    with ExitStack() as stack:
        runners = {}
        for side, plan, command in zip((BASE, NEW), (base, new), commands, strict=True):
            held = stack.enter_context(holding_folder(folder / side, progress.note))
            station = stack.enter_context(
                open_station(plan, folder / side, held, show=progress.note, command=command)
            )
            runners[side] = Runner(plan, folder / side, station, _SideProgress(progress, side))
        for warning in dict.fromkeys([*depth_warnings(base), *depth_warnings(new)]):
            progress.note(warning)
        for runner in runners.values():
            runner.prepare()
        done = sum(runners[side].state[cell.name].done for side in cells for cell in cells[side])
        progress.begin(len(turns), done)
        try:
            for turn in turns:
                runners[turn.side].run_group(turn.group, cells[turn.side])
        finally:
            progress.end()
        outcomes = [
            SweepOutcome(folder / side, len(cells[side]), runners[side].reasons(cells[side]))
            for side in (BASE, NEW)
        ]
    return AgainstOutcome(folder, *outcomes)


class _SideProgress:
    """Progress of one side, handed on with the side's name before the cell's.

    Args:
        progress: receiver of both sides.
        side: name of this one.
    """

    def __init__(self, progress: SweepProgress, side: str) -> None:
        self._progress = progress
        self._side = side

    def begin(self, cells: int, done: int) -> None:
        """Take nothing: the sweep of both sides has one beginning."""

    def relay(self, name: str) -> None:
        """Hand on the name of the relay."""
        self._progress.relay(f"{self._side} {name}")

    def cell(self, name: str, remaining: Remaining) -> None:
        """Hand on the cell; the other side, which takes turns with this one, has about the same time left."""
        self._progress.cell(f"{self._side} {name}", Remaining(2 * remaining.seconds))

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        """Hand on the end of the cell."""
        self._progress.ended(f"{self._side} {name}", outcome, complete=complete)

    def note(self, text: str) -> None:
        """Hand on the line."""
        self._progress.note(f"{self._side}: {text}")

    def end(self) -> None:
        """Take nothing: the sweep of both sides has one end."""
