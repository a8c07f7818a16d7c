"""`run_sweep` and `run_search`: a plan and a folder in, traces and what is still missing out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .plan.schedule import schedule
from .run.lock import holding_folder
from .run.runner import Runner
from .search import find_max_rates, search_plan
from .station.station import open_station

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .plan.plan import Plan
    from .run.progress import SweepProgress
    from .search import MaxRate

INCOMPLETE_EXIT_CODE = 10
"""Of `dds-sweep`: some cells have no complete recording. Complete is 0; 1 to 9 are errors of the `TraceError` tree."""


@dataclass(frozen=True, slots=True)
class SweepOutcome:
    """What a sweep left behind.

    Attributes:
        folder: with the traces and `state.json`.
        cells: of the plan, repeats included.
        missing: name of each cell without a complete recording -> why.
    """

    folder: Path
    cells: int
    missing: dict[str, str]


def run_sweep(
    plan: Plan,
    out: Path,
    progress: SweepProgress,
    *,
    command: Sequence[str] | None = None,
) -> SweepOutcome:
    """Records every cell of the plan that is not complete below `out`.

    Args:
        plan: what to record.
        out: the plan's folder is made in it.
        progress: hears what happens.
        command: as for `open_station`.

    Raises:
        TraceError: nothing can be recorded at all; what failed in single cells is in the outcome.
    """
    folder = out / plan.name
    groups = schedule(plan)
    with (
        holding_folder(folder, progress.note) as held,
        open_station(plan, folder, held, show=progress.note, command=command) as station,
    ):
        runner = Runner(plan, folder, station, progress)
        missing = runner.run(groups)
        reasons = {
            name: runner.state[name].reason or "the relay's trace is still on its device" for name in missing
        }
    return SweepOutcome(folder, sum(len(group.cells) for group in groups), reasons)


def run_search(
    plan: Plan,
    out: Path,
    progress: SweepProgress,
    *,
    command: Sequence[str] | None = None,
) -> tuple[Path, list[MaxRate]]:
    """The folder of the trials, and the highest rate of each cell of the plan, its rates apart.

    Raises:
        TraceError: as `run_sweep`.
    """
    searched = search_plan(plan)
    folder = out / searched.name
    with (
        holding_folder(folder, progress.note) as held,
        open_station(searched, folder, held, show=progress.note, command=command) as station,
    ):
        runner = Runner(searched, folder, station, progress)
        runner.resume()
        station.device.prepare()
        progress.begin(0, 0)
        try:
            return folder, list(find_max_rates(searched, runner))
        finally:
            progress.end()
