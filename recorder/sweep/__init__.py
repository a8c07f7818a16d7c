"""The whole parameter space from one plan: cells, their order, the devices, the link between them, the state."""

from recorder.sweep.cells import Cell
from recorder.sweep.commands import half_arguments, relay_arguments
from recorder.sweep.devices import printed_command
from recorder.sweep.estimate import Remaining, plan_seconds
from recorder.sweep.installed import installed_middlewares
from recorder.sweep.link import PRESETS, Link
from recorder.sweep.max_rate_report import COLUMNS, max_rate_rows, write_max_rates
from recorder.sweep.plan import Plan
from recorder.sweep.plan_file import parse_plan, read_plan
from recorder.sweep.progress import SweepProgress, make_progress
from recorder.sweep.result import CellResult, read_result
from recorder.sweep.schedule import Group, schedule
from recorder.sweep.search import Answer, MaxRate
from recorder.sweep.sweep import INCOMPLETE_EXIT_CODE, SweepOutcome, run_search, run_sweep

__all__ = [
    "COLUMNS",
    "INCOMPLETE_EXIT_CODE",
    "PRESETS",
    "Answer",
    "Cell",
    "CellResult",
    "Group",
    "Link",
    "MaxRate",
    "Plan",
    "Remaining",
    "SweepOutcome",
    "SweepProgress",
    "half_arguments",
    "installed_middlewares",
    "make_progress",
    "max_rate_rows",
    "parse_plan",
    "plan_seconds",
    "printed_command",
    "read_plan",
    "read_result",
    "relay_arguments",
    "run_search",
    "run_sweep",
    "schedule",
    "write_max_rates",
]
