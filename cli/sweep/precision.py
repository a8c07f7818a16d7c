"""`dds-sweep --until`: the precision of a sweep's cells, computed by the analyzer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from dds_trace.recorder.sweep.plan.plan import Plan
    from dds_trace.recorder.sweep.sweep import Until


def precision(text: str, max_passes: int | None, plan: Plan) -> Until:
    from dds_trace.analyzer.verdicts.false_alarms import check_statistic
    from dds_trace.recorder.sweep.plan.plan_file import check_runs
    from dds_trace.recorder.sweep.sweep import DEFAULT_MAX_PASSES, Until, parse_target

    statistic, percent = parse_target(text)
    check_statistic(statistic)
    most = max(DEFAULT_MAX_PASSES, plan.run.repeats) if max_passes is None else max_passes
    if most < plan.run.repeats:
        raise OptionError(
            f"--max-passes {most} is below the {plan.run.repeats} repeats of the plan; give at least as many"
        )
    check_runs("--max-passes", len(plan.cells), most)

    def measure(folder: Path, runs: Mapping[str, tuple[int, ...]]) -> Mapping[str, float]:
        from dds_trace.analyzer.pipeline import analyze
        from dds_trace.analyzer.verdicts.false_alarms import half_widths

        if not runs:  # nothing was recorded
            return {}
        return half_widths(analyze(folder, details=False).load_messages(), runs, statistic)

    return Until(statistic, percent, most, measure)
