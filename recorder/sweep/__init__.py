"""The whole parameter space from one plan: cells, their order, the devices, the link between them, the state."""

from dds_trace.recorder.sweep.max_rate_report import COLUMNS, max_rate_rows, write_max_rates
from dds_trace.recorder.sweep.plan.cells import Cell
from dds_trace.recorder.sweep.plan.commands import half_arguments, relay_arguments
from dds_trace.recorder.sweep.plan.estimate import Remaining, plan_seconds
from dds_trace.recorder.sweep.plan.installed import installed_middlewares
from dds_trace.recorder.sweep.plan.link import PRESETS, Link
from dds_trace.recorder.sweep.plan.plan import Plan
from dds_trace.recorder.sweep.plan.plan_file import parse_plan, read_plan
from dds_trace.recorder.sweep.plan.schedule import Group, schedule
from dds_trace.recorder.sweep.run.progress import SweepProgress, make_progress
from dds_trace.recorder.sweep.run.result import CellResult, read_result
from dds_trace.recorder.sweep.search import Answer, MaxRate
from dds_trace.recorder.sweep.station.devices import printed_command
from dds_trace.recorder.sweep.sweep import INCOMPLETE_EXIT_CODE, SweepOutcome, run_search, run_sweep

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
