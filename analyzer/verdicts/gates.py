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
of it does, and is inconclusive in between or where a sample does not support the percentile.
"""

from __future__ import annotations

import difflib
import operator
import re
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile.errors import OptionError
from dds_trace.tracefile.units.durations import UNIT_NS
from dds_trace.tracefile.units.quantities import split_quantity

from ..model.metrics import METRICS
from .compare import QUANTILES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .compare import CompareOptions, Comparison

STATISTICS = ("mean", *QUANTILES)
RECEIVED_RATIO = "received_ratio"
GATE_METRICS = (*(f"{metric}_{statistic}" for metric in METRICS for statistic in STATISTICS), RECEIVED_RATIO)
_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
}
_GATE = re.compile(r"\s*(?P<metric>[A-Za-z0-9_.]+)\s*(?P<operator>>=|<=|>|<)\s*(?P<limit>\S.*?)\s*")


class GateOutcome(Enum):
    """What came of a gate; `exit_code` for the shell, apart from those of `TraceError`."""

    PASSED = "passed"
    REGRESSED = "regressed"
    INCONCLUSIVE = "inconclusive"
    NOTHING_TO_COMPARE = "nothing to compare"

    @property
    def exit_code(self) -> int:
        """Exit code of a command whose gates came out like this."""
        return _EXIT_CODES[self]


_EXIT_CODES = {
    GateOutcome.PASSED: 0,
    GateOutcome.REGRESSED: 20,
    GateOutcome.INCONCLUSIVE: 21,
    GateOutcome.NOTHING_TO_COMPARE: 22,
}


class Against(Enum):
    """What a limit is measured against; the values are prefixes of the columns of a comparison."""

    RATIO = "ratio"  # change as a share of the base
    DIFFERENCE = "difference"  # change in ns
    NEW = "new"  # the new side alone


@dataclass(frozen=True, slots=True)
class Gate:
    """A condition under which a comparison fails.

    Attributes:
        text: as it was written.
        metric: `latency`, `rtt`, `response`, `intermediate` or `received_ratio`.
        statistic: `mean` or a percentile; empty for `received_ratio`.
        operator: `>`, `>=`, `<` or `<=`.
        against: what the limit is measured against.
        limit: a ratio new / base for `RATIO`, ns for `DIFFERENCE` and `NEW` (a share for `received_ratio`).
    """

    text: str
    metric: str
    statistic: str
    operator: str
    against: Against
    limit: float

    def judge(self, value: float | None, low: float | None, high: float | None) -> GateOutcome:
        """The outcome for an estimate and its interval; an end that is None is one that nobody knows."""
        if value is None or low is None or high is None:
            return GateOutcome.INCONCLUSIVE
        fails = [_OPERATORS[self.operator](end, self.limit) for end in (low, high)]
        if all(fails):
            return GateOutcome.REGRESSED
        return GateOutcome.INCONCLUSIVE if any(fails) else GateOutcome.PASSED


def parse_gate(text: str) -> Gate:
    """The gate that a text of the module's grammar describes.

    Raises:
        OptionError: the text is none; the message says where it went wrong and names the nearest metric.
    """
    found = _GATE.fullmatch(text)
    if found is None:
        raise OptionError(f"--fail-if {text!r}: write METRIC > LIMIT, for example 'latency_p99 > +10%'")
    metric, statistic = _parse_metric(text, found["metric"])
    against, limit = _parse_limit(text, found["limit"], metric)
    return Gate(text.strip(), metric, statistic, found["operator"], against, limit)


def _parse_metric(text: str, name: str) -> tuple[str, str]:
    spelled = name.lower().replace(".", "_")  # p99.9 is meant as p99_9
    if spelled not in GATE_METRICS:
        near = difflib.get_close_matches(spelled, GATE_METRICS, n=1, cutoff=0)[0]
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
    """A gate on one group.

    Attributes:
        where: the group, in words: the parameters that tell the compared groups apart.
        measured: what was measured against the limit, in the limit's terms, with its interval.
    """

    gate: Gate
    where: str
    outcome: GateOutcome
    measured: float | None
    low: float | None
    high: float | None


def options_for(gates: Sequence[Gate], options: CompareOptions) -> CompareOptions:
    """The options with every metric and statistic that the gates need."""
    timed = [gate for gate in gates if gate.statistic]
    return replace(
        options,
        metrics=tuple(dict.fromkeys([*options.metrics, *(gate.metric for gate in timed)])),
        statistics=tuple(dict.fromkeys([*options.statistics, *(gate.statistic for gate in timed)])),
    )


def judge_gates(comparison: Comparison, gates: Sequence[Gate]) -> list[GateResult]:
    """Every gate on every matched group, groups in the order of the comparison (made with `options_for` the gates)."""
    names = varying_columns(comparison)
    results = []
    for gate in gates:
        judge = _judge_received if gate.metric == RECEIVED_RATIO else _judge_time
        results += judge(comparison, gate, names)
    return results


def overall_outcome(results: Sequence[GateResult]) -> GateOutcome:
    """Regressed if any gate failed, else inconclusive if any is, else passed; nothing to compare without a result."""
    for outcome in (GateOutcome.REGRESSED, GateOutcome.INCONCLUSIVE, GateOutcome.PASSED):
        if any(result.outcome is outcome for result in results):
            return outcome
    return GateOutcome.NOTHING_TO_COMPARE


def varying_columns(comparison: Comparison) -> list[str]:
    """The match columns that differ between the compared groups; vendor, bridge, data and size at least."""
    always = {"vendor", "bridge", "data_type", "payload_bytes", "rate_hz"}
    groups = comparison.delivery
    return [n for n in comparison.options.match if n in always or groups[n].n_unique() > 1]


def group_words(row: dict[str, Any], names: Sequence[str]) -> str:
    """A group in words: `vendor=fastdds payload_bytes=33000 ...`."""
    return " ".join(
        f"{name}={row[name]:g}" if isinstance(row[name], float) else f"{name}={row[name]}" for name in names
    )


def _judge_time(comparison: Comparison, gate: Gate, names: Sequence[str]) -> list[GateResult]:
    unit = "" if gate.against is Against.RATIO else "_ns"
    columns = [f"{gate.against.value}{end}{unit}" for end in ("", "_low", "_high")]
    rows = comparison.rows.filter(
        (comparison.rows["metric"] == gate.metric) & (comparison.rows["statistic"] == gate.statistic),
    )
    return [_result(gate, row, columns, names) for row in rows.iter_rows(named=True)]


def _judge_received(comparison: Comparison, gate: Gate, names: Sequence[str]) -> list[GateResult]:
    columns = [f"new_received_ratio{end}" for end in ("", "_low", "_high")]
    return [_result(gate, row, columns, names) for row in comparison.delivery.iter_rows(named=True)]


def _result(gate: Gate, row: dict[str, Any], columns: Sequence[str], names: Sequence[str]) -> GateResult:
    value, low, high = (row[column] for column in columns)
    return GateResult(gate, group_words(row, names), gate.judge(value, low, high), value, low, high)
