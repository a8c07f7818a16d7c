"""`[thresholds]` of a plan: what every result of a sweep has to meet, judged as the sweep ends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted, format_duration

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from dds_trace.analyzer.verdicts.gate import Gate
    from dds_trace.analyzer.verdicts.gates import GateResult
    from dds_trace.recorder.sweep.plan.plan import Plan
    from dds_trace.recorder.sweep.sweep import Until

_OUTCOMES = {"passed": "passed", "regressed": "failed", "inconclusive": "undecided"}


@dataclass(frozen=True, slots=True)
class Judged:
    result: GateResult

    @property
    def outcome(self) -> str:
        return _OUTCOMES[self.result.outcome.value]

    def to_json(self) -> dict[str, object]:
        """Return an entry of `thresholds` in the JSON output; times in ns, null where unknown or infinite."""
        numbers = {name: getattr(self.result, name) for name in ("measured", "low", "high")}
        return {
            "threshold": self.result.gate.text,
            "result": self.result.where,
            "outcome": self.outcome,
            **{name: value if value is not None and math.isfinite(value) else None for name, value in numbers.items()},
            "reason": self.result.reason,
        }

    def __str__(self) -> str:
        ends = [_value(self.result.gate, end) for end in (self.result.low, self.result.high)]
        measured = f"{_value(self.result.gate, self.result.measured)} ({ends[0]} to {ends[1]})"
        reason = f"; {self.result.reason}" if self.result.reason else ""
        return f"{self.outcome}: {self.result.gate.text}: {self.result.where}: {measured}{reason}"


def _value(gate: Gate, value: float | None) -> str:
    if value is None:
        return "unknown"
    if not gate.statistic:
        return f"{100 * value:.6g} %"
    return "lost" if math.isinf(value) else format_duration(value)


def read_thresholds(plan: Plan, until: Until | None, *, is_judged: bool) -> list[Gate]:
    """Return the gates of a plan; refuse what could not be judged before the first recording."""
    if not plan.thresholds:
        return []
    from dds_trace.analyzer.statistics.intervals import MIN_RUNS
    from dds_trace.analyzer.verdicts.gate import parse_threshold

    gates = [parse_threshold(metric, text) for metric, texts in plan.thresholds.items() for text in texts]
    if not is_judged:
        raise OptionError("[thresholds] judge a sweep of the plan itself; remove the table, or --max-rate or --against")
    if (plan.run.repeats if until is None else until.max_passes) < MIN_RUNS:
        raise OptionError(f"[thresholds] need {MIN_RUNS} runs of each result; give [run] repeats = {MIN_RUNS} or more")
    return gates


def judge(folder: Path, gates: Sequence[Gate]) -> list[Judged]:
    from dds_trace.analyzer.pipeline import analyze
    from dds_trace.analyzer.verdicts.compare import CompareOptions, compare
    from dds_trace.analyzer.verdicts.gates import judge_gates, options_for

    analysis = analyze(folder, details=False)
    comparison = compare(analysis, analysis, options_for(gates, CompareOptions()))
    return [Judged(result) for result in judge_gates(comparison, gates)]


def shown(judged: Sequence[Judged]) -> list[str]:
    if not judged:
        return []
    failing = [str(one) for one in judged if one.outcome != "passed"]
    return [*failing, f"{len(judged) - len(failing)} of {counted(len(judged), 'threshold')} passed"]


def exit_code_of(judged: Sequence[Judged]) -> int:
    if not judged:
        return 0
    from dds_trace.analyzer.verdicts.gates import overall_outcome

    return overall_outcome([one.result for one in judged]).exit_code
