"""Gates for CI: `--fail-if "latency_p99 > +10%"` against a comparison.

    gate      = metric ws (">" | ">=" | "<" | "<=") ws limit
    limit     = sign number "%"          change against the base, as a share of it:  latency_p99 > +10%
              | sign number unit         change against the base:                    rtt_p50 > +2ms
              | number unit              the new side alone:                         latency_p99_9 > 20ms
              | number "%"               the new side alone, for ratios:             received_ratio < 99%
    metric    = ("latency" | "rtt" | "response" | "intermediate") "_" statistic | "received_ratio"
    statistic = "mean" | "p50" | "p90" | "p95" | "p99" | "p99_9"
    unit      = "ns" | "us" | "ms" | "s"

A gate is about what is surely so: it fails where the whole confidence interval lies beyond the limit, passes where none
of it does, and is inconclusive in between, where a sample does not support the percentile, or where a setting was asked
for and not applied: such a group did not measure what it says.
"""

from __future__ import annotations

import difflib
import operator
import re
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from dds_trace.tracefile.errors import OptionError
from dds_trace.tracefile.units.durations import UNIT_NS
from dds_trace.tracefile.units.quantities import split_quantity

from ..model.metrics import METRICS
from ..model.names import group_words, varying_parameters
from .compare import COMPARED_STATISTICS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import polars as pl

    from .compare import CompareOptions, Comparison

RECEIVED_RATIO = "received_ratio"
_GATE_METRICS = (
    *(f"{metric}_{statistic}" for metric in METRICS for statistic in COMPARED_STATISTICS),
    RECEIVED_RATIO,
)
_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
}
_GATE = re.compile(r"\s*(?P<metric>[A-Za-z0-9_.]+)\s*(?P<operator>>=|<=|>|<)\s*(?P<limit>\S.*?)\s*")


class GateOutcome(Enum):
    """The outcome of a gate; its exit codes differ from those of `TraceError`."""

    PASSED = "passed"
    REGRESSED = "regressed"
    INCONCLUSIVE = "inconclusive"
    NOTHING_TO_COMPARE = "nothing to compare"

    @property
    def exit_code(self) -> int:
        """Exit code of a command whose gates have this outcome."""
        return _EXIT_CODES[self]


NOT_APPLIED = "a setting that was asked for was not applied"
"""End of `GateResult.where` of a group that is barred."""

_EXIT_CODES = {
    GateOutcome.PASSED: 0,
    GateOutcome.REGRESSED: 20,
    GateOutcome.INCONCLUSIVE: 21,
    GateOutcome.NOTHING_TO_COMPARE: 22,
}


class Against(Enum):
    """The value that a limit applies to, by the prefix of its columns in a comparison."""

    RATIO = "ratio"  # change as a share of the base
    DIFFERENCE = "difference"  # change in ns
    NEW = "new"  # the new side alone


@dataclass(frozen=True, slots=True)
class Gate:
    """A condition under which a comparison fails.

    Attributes:
        text: the gate as it was written.
        metric: `latency`, `rtt`, `response`, `intermediate` or `received_ratio`.
        statistic: `mean` or a percentile; empty for `received_ratio`.
        operator: `>`, `>=`, `<` or `<=`.
        against: the value that the limit applies to.
        limit: a ratio new / base for `RATIO`, ns for `DIFFERENCE` and `NEW` (a share for `received_ratio`).
    """

    text: str
    metric: str
    statistic: str
    operator: str
    against: Against
    limit: float

    def judge(self, value: float | None, low: float | None, high: float | None) -> GateOutcome:
        """Judge an estimate by its interval; an end that is None is unknown."""
        if value is None or low is None or high is None:
            return GateOutcome.INCONCLUSIVE
        fails = [_OPERATORS[self.operator](end, self.limit) for end in (low, high)]
        if all(fails):
            return GateOutcome.REGRESSED
        return GateOutcome.INCONCLUSIVE if any(fails) else GateOutcome.PASSED


def parse_gate(text: str) -> Gate:
    """Read a gate in the grammar of this module.

    Raises:
        OptionError: the text is not a gate; the message says where it goes wrong and names the nearest metric.
    """
    match = _GATE.fullmatch(text)
    if match is None:
        raise OptionError(f"--fail-if {text!r}: write METRIC > LIMIT, for example 'latency_p99 > +10%'")
    metric, statistic = _parse_metric(text, match["metric"])
    against, limit = _parse_limit(text, match["limit"], metric)
    return Gate(text.strip(), metric, statistic, match["operator"], against, limit)


def _parse_metric(text: str, name: str) -> tuple[str, str]:
    spelled = name.lower().replace(".", "_")  # p99.9 is meant as p99_9
    if spelled not in _GATE_METRICS:
        near = difflib.get_close_matches(spelled, _GATE_METRICS, n=1, cutoff=0)[0]
        raise OptionError(f"--fail-if {text!r}: no metric {name!r}; did you mean {near!r}?")
    if spelled == RECEIVED_RATIO:
        return spelled, ""
    metric, _, statistic = spelled.partition("_")
    return metric, statistic


def _parse_limit(text: str, limit: str, metric: str) -> tuple[Against, float]:
    sign = limit[0] if limit[0] in "+-" else ""
    number, unit = split_quantity(limit[len(sign) :]) or (0.0, "")
    if unit != "%" and unit not in UNIT_NS:
        raise OptionError(
            f"--fail-if {text!r}: no limit {limit!r}; write a change such as +10% or +2ms, or a value such as 20ms",
        )
    number = -number if sign == "-" else number
    is_share, is_signed = unit == "%", bool(sign)
    if metric == RECEIVED_RATIO:
        if not is_share or is_signed:
            raise OptionError(f"--fail-if {text!r}: {RECEIVED_RATIO} takes a share such as 99%")
        return Against.NEW, number / 100
    if is_share:
        if not is_signed:
            raise OptionError(f"--fail-if {text!r}: write +{limit} for a change against the base")
        return Against.RATIO, 1 + number / 100
    return Against.DIFFERENCE if is_signed else Against.NEW, number * UNIT_NS[unit]


@dataclass(frozen=True, slots=True)
class GateResult:
    """The outcome of a gate for one group.

    Attributes:
        gate: the gate.
        where: the group in words: the parameters that tell the compared groups apart.
        outcome: the outcome.
        measured: the measured value in the unit of the limit.
        low: lower end of its interval.
        high: upper end of its interval.
    """

    gate: Gate
    where: str
    outcome: GateOutcome
    measured: float | None
    low: float | None
    high: float | None


def options_for(gates: Sequence[Gate], options: CompareOptions) -> CompareOptions:
    """Add every metric and statistic that the gates need to the options."""
    timed = [gate for gate in gates if gate.statistic]
    return replace(
        options,
        metrics=tuple(dict.fromkeys([*options.metrics, *(gate.metric for gate in timed)])),
        statistics=tuple(dict.fromkeys([*options.statistics, *(gate.statistic for gate in timed)])),
    )


def judge_gates(comparison: Comparison, gates: Sequence[Gate]) -> list[GateResult]:
    """Judge every matched group by every gate, gate by gate; the comparison was made with `options_for` the gates."""
    names = varying_columns(comparison)
    results: list[GateResult] = []
    for gate in gates:
        judge = _judge_received if gate.metric == RECEIVED_RATIO else _judge_time
        results += judge(comparison, gate, names)
    return results


def overall_outcome(results: Sequence[GateResult]) -> GateOutcome:
    """Return regressed if any gate failed, else inconclusive if any is, else passed; without results, nothing to compare."""
    for outcome in (GateOutcome.REGRESSED, GateOutcome.INCONCLUSIVE, GateOutcome.PASSED):
        if any(result.outcome is outcome for result in results):
            return outcome
    return GateOutcome.NOTHING_TO_COMPARE


def varying_columns(comparison: Comparison) -> list[str]:
    """Return the match columns that differ between the compared groups, and always those of vendor, bridge and message."""
    return varying_parameters(comparison.delivery, comparison.options.match)


def _judge_time(comparison: Comparison, gate: Gate, names: Sequence[str]) -> Iterator[GateResult]:
    unit = "" if gate.against is Against.RATIO else "_ns"
    columns = [f"{gate.against.value}{end}{unit}" for end in ("", "_low", "_high")]
    rows = comparison.rows.filter(metric=gate.metric, statistic=gate.statistic)
    return _judge_rows(comparison, rows, gate, columns, names)


def _judge_received(comparison: Comparison, gate: Gate, names: Sequence[str]) -> Iterator[GateResult]:
    columns = [f"new_received_ratio{end}" for end in ("", "_low", "_high")]
    return _judge_rows(comparison, comparison.delivery, gate, columns, names)


def _judge_rows(
    comparison: Comparison, rows: pl.DataFrame, gate: Gate, columns: Sequence[str], names: Sequence[str]
) -> Iterator[GateResult]:
    """Judge every row; `columns` are those of the value and of the ends of its interval."""
    barred = set(comparison.barred.iter_rows())
    for row in rows.iter_rows(named=True):
        value, low, high = (row[column] for column in columns)
        where, outcome = group_words(row, names), gate.judge(value, low, high)
        if tuple(row[name] for name in comparison.options.match) in barred:
            where, outcome = f"{where}; {NOT_APPLIED}", GateOutcome.INCONCLUSIVE
        yield GateResult(gate, where, outcome, value, low, high)
