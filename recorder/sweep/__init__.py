"""The whole parameter space from one plan: cells, their order, the devices, the link between them, the state."""

from recorder.sweep.cells import Cell
from recorder.sweep.commands import relay_arguments
from recorder.sweep.devices import printed_command
from recorder.sweep.estimate import Remaining, plan_seconds
from recorder.sweep.link import PRESETS, Link
from recorder.sweep.plan import Plan
from recorder.sweep.plan_file import parse_plan, read_plan
from recorder.sweep.progress import SweepProgress, make_progress
from recorder.sweep.result import CellResult, read_result
from recorder.sweep.schedule import Group, schedule
from recorder.sweep.search import Answer, MaxRate
from recorder.sweep.sweep import INCOMPLETE_EXIT_CODE, SweepOutcome, run_search, run_sweep

__all__ = [
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
    "make_progress",
    "parse_plan",
    "plan_seconds",
    "printed_command",
    "read_plan",
    "read_result",
    "relay_arguments",
    "run_search",
    "run_sweep",
    "schedule",
]
