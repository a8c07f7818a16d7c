"""`run_sweep` and `run_search`: from a plan to the traces of its cells below a folder."""

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
"""Exit code of `dds-sweep` if some cells have no complete recording; 1 to 9 are those of the `TraceError` tree."""


@dataclass(frozen=True, slots=True)
class SweepOutcome:
    """Result of a sweep.

    Attributes:
        folder: folder with the traces and `state.json`.
        cells: number of cells of the plan, repeats included.
        missing: name of each cell without a complete recording -> the reason.
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
    """Record every cell of the plan that is not complete below `out`.

    Args:
        plan: the plan to record.
        out: folder in which the plan's folder is made.
        progress: receiver of every step.
        command: `dds-record` on this machine; the installed one if left out.

    Raises:
        TraceError: no cell can be recorded at all; failures of single cells are in the outcome.
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
    """Search the highest rate of each cell of the plan, whatever its rates; return the folder of the trials and the answers.

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
