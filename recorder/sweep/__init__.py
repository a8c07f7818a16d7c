"""The whole parameter space from one plan: cells, their order, the devices, the link between them, the state."""

from typing import TYPE_CHECKING

from dds_trace.lazy import contents_page

if TYPE_CHECKING:
    from ..backends import installed_middlewares
    from .against import BASE, NEW, AgainstOutcome, against_seconds, run_against, take_turns
    from .max_rate_report import COLUMNS, max_rate_rows, write_max_rates
    from .plan.cells import Cell, environment_name
    from .plan.commands import half_arguments, relay_arguments
    from .plan.link import PRESETS, Link
    from .plan.plan import Plan, depth_warnings
    from .plan.plan_file import check_runs, parse_plan, read_plan
    from .plan.schedule import CellGroup, Remaining, plan_seconds, schedule
    from .plan.schema import SCHEMA_FILE_NAME, plan_schema, schema_text
    from .plan.template import (
        COMPARISONS,
        DATA_EXAMPLE,
        HERE,
        check_place,
        parse_comparisons,
        parse_messages,
        plan_text,
    )
    from .rehearsal import rehearse_plan
    from .run.progress import SweepProgress, make_progress
    from .run.result import CellResult, read_result
    from .search import MaxRate, RateAnswer, search_plan
    from .station.devices import printed_command
    from .station.programs import environment_program
    from .sweep import INCOMPLETE_EXIT_CODE, TOO_WIDE_EXIT_CODE, SweepOutcome, run_search, run_sweep
    from .until import DEFAULT_MAX_PASSES, Until, parse_target
else:
    __getattr__, __dir__ = contents_page(__name__)

__all__ = [
    "BASE",
    "COLUMNS",
    "COMPARISONS",
    "DATA_EXAMPLE",
    "DEFAULT_MAX_PASSES",
    "HERE",
    "INCOMPLETE_EXIT_CODE",
    "NEW",
    "PRESETS",
    "SCHEMA_FILE_NAME",
    "TOO_WIDE_EXIT_CODE",
    "AgainstOutcome",
    "Cell",
    "CellGroup",
    "CellResult",
    "Link",
    "MaxRate",
    "Plan",
    "RateAnswer",
    "Remaining",
    "SweepOutcome",
    "SweepProgress",
    "Until",
    "against_seconds",
    "check_place",
    "check_runs",
    "depth_warnings",
    "environment_name",
    "environment_program",
    "half_arguments",
    "installed_middlewares",
    "make_progress",
    "max_rate_rows",
    "parse_comparisons",
    "parse_messages",
    "parse_plan",
    "parse_target",
    "plan_schema",
    "plan_seconds",
    "plan_text",
    "printed_command",
    "read_plan",
    "read_result",
    "rehearse_plan",
    "relay_arguments",
    "run_against",
    "run_search",
    "run_sweep",
    "schedule",
    "schema_text",
    "search_plan",
    "take_turns",
    "write_max_rates",
]
