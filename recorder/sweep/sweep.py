"""`run_sweep` and `run_search`: from a plan to the traces of its cells below a folder."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from .plan.plan import depth_warnings
from .plan.schedule import schedule
from .run.lock import holding_folder
from .run.runner import Runner
from .search import find_max_rates, search_plan
from .station.station import open_station
from .until import run_further_passes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .plan.plan import Plan
    from .run.progress import SweepProgress
    from .search import MaxRate
    from .until import Until

INCOMPLETE_EXIT_CODE = 10
"""Exit code of `dds-sweep` if some cells have no complete recording; 1 to 9 are those of the `TraceError` tree."""

TOO_WIDE_EXIT_CODE = 11
"""Exit code of `dds-sweep --until` if everything is recorded and some cells are still too wide after the last pass."""


@dataclass(frozen=True, slots=True)
class SweepOutcome:
    """Result of a sweep.

    Attributes:
        folder: folder with the traces and `state.json`.
        cells: number of cells of the plan, repeats included.
        missing: name of each cell without a complete recording -> the reason.
        too_wide: name of each cell whose interval is wider than asked for -> half width in percent.
    """

    folder: Path
    cells: int
    missing: dict[str, str]
    too_wide: dict[str, float] = field(default_factory=dict)


def run_sweep(
    plan: Plan,
    out: Path,
    progress: SweepProgress,
    *,
    command: Sequence[str] | None = None,
    until: Until | None = None,
) -> SweepOutcome:
    """Record every cell of the plan that is not complete below `out`.

    Args:
        plan: the plan to record.
        out: folder in which the plan's folder is made.
        progress: receiver of every step.
        command: `dds-record` on this machine; the installed one if left out.
        until: precision up to which further passes are run; None for the passes of the plan alone.

    Raises:
        TraceError: no cell can be recorded at all; failures of single cells are in the outcome.
    """
    folder = out / plan.name
    groups = schedule(plan)
    with (
        holding_folder(folder, progress.note) as held,
        open_station(plan, folder, held, show=progress.note, command=command) as station,
    ):
        for warning in depth_warnings(plan):
            progress.note(warning)
        runner = Runner(plan, folder, station, progress)
        runner.run(groups)
        cells = [cell for group in groups for cell in group.cells]
        too_wide: dict[str, float] = {}
        if until is not None:
            further = run_further_passes(plan, runner, until, progress.note)
            cells += further.cells
            too_wide = further.too_wide
        return SweepOutcome(folder, len(cells), runner.reasons(cells), too_wide)


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
        runner.prepare()
        progress.begin(0, 0)
        try:
            return folder, list(find_max_rates(searched, runner))
        finally:
            progress.end()
