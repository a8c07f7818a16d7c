"""A comparison judged by gates: an outcome for each gate and group, adjusted by Holm over the groups, with its reason."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from dds_trace.analyzer.model.metrics import METRICS
from dds_trace.analyzer.model.names import group_words, is_topic, varying_parameters
from dds_trace.analyzer.run_statistics.change import Change
from dds_trace.analyzer.run_statistics.spread import runs_to_settle_ratio, runs_to_settle_value, spread_of_runs
from dds_trace.analyzer.statistics.distributions import student_cdf, student_quantile
from dds_trace.analyzer.statistics.intervals import MIN_RUNS, Basis, Interval
from dds_trace.analyzer.statistics.power import MOST_RUNS, holm_adjusted, messages_to_close
from dds_trace.analyzer.verdicts.judgements import Claim, Judgement
from dds_trace.analyzer.verdicts.setup_runs import SetupRuns
from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted, format_duration, format_number

from .compare import RECEIVED_RATIO, STATISTIC_BY_NAME, CompareOptions, Comparison
from .detectable import among_tests
from .gate import Against, Gate, GateOutcome, rows_of_gates
from .matching import Key
from .sections import fits_any

ALL_GROUPS = Gate("every group of the base answers", RECEIVED_RATIO, "", "<=", Against.NEW, 0.0)

NOT_APPLIED = "a requested setting was not applied"

UNDECIDABLE = "more runs of this kind do not decide"

FAMILY = "Holm over groups"

_MOST_TOPICS = 10

_ROUNDING = 1e-12
"""Error of a difference of two shares in floats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GateResult(Judgement):
    """A row of the frame: the outcome of a gate for one result.

    Attributes:
        value: the measured value in the unit of the limit.
        reason: why the outcome is inconclusive, and what it takes to decide; or what is missing.
        smallest_ratio: the smallest ratio above 1 that these runs would have detected with a probability of 80 %.
        smallest_drop: the same of a received ratio: the smallest loss of share.
        found_from: the change, in the unit of the limit, from which on the gate would have failed with a probability of 80 %
            if only this group had it.
    """

    gate: Gate
    smallest_ratio: float | None = None
    smallest_drop: float | None = None
    found_from: float | None = None

    @property
    def outcome(self) -> GateOutcome:
        """The verdict."""
        return GateOutcome(self.verdict)


def result_of(
    gate: Gate,
    where: str,
    outcome: GateOutcome,
    value: float | None = None,
    low: float | None = None,
    high: float | None = None,
    **more: Any,
) -> GateResult:
    """Return a row of the frame."""
    row = Claim.KEEPS, where, gate.name, gate.text, value, low, high
    return GateResult(*row, verdict=outcome.value, gate=gate, **more)


class _Advice(NamedTuple):
    text: str
    runs: int | None = None


@dataclass(frozen=True, slots=True)
class _Measured:
    """A result by its key; `p_of_lost` is the p value of runs that are all lost, where the interval is infinite."""

    result: GateResult
    key: Key
    degrees: float | None
    advice: _Advice
    p_of_lost: float
    base_ns: float

    def p_beyond(self, confidence: float, *, is_ratio: bool) -> float:
        limit, value, low, high = self.result.gate.limit, self.result.value, self.result.low, self.result.high
        end = low if value is not None and value > limit else high
        if value is None or end is None:
            return (1 - confidence) / 2
        least = self.p_of_lost if any(map(math.isinf, (value, low or 0, high or 0))) else 0.0
        if math.isinf(end):
            return least
        if math.isinf(value) and limit <= 0:
            return least
        if math.isinf(value):
            far, near, at = 0.0, -1 / end, -1 / limit
        elif is_ratio and min(value, end, limit) > 0:
            far, near, at = math.log(value), math.log(end), math.log(limit)
        else:
            far, near, at = value, end, limit
        if far == near:
            return least
        degrees = math.inf if self.degrees is None else self.degrees
        reach = student_quantile((1 + confidence) / 2, degrees)
        return max(least, student_cdf(-reach * (far - at) / (far - near), degrees))

    def found_from(self, tests: int, confidence: float) -> float | None:
        gate, smallest_ratio = self.result.gate, self.result.smallest_ratio
        smallest = self.result.smallest_drop if smallest_ratio is None else smallest_ratio
        if smallest is None or self.degrees is None or gate.against is Against.NEW:
            return None
        scale = among_tests(self.degrees, tests, confidence) * (1 if gate.operator in (">", ">=") else -1)
        if smallest_ratio is None:
            return gate.limit + scale * smallest
        ratio = gate.limit if gate.against is Against.RATIO else 1 + gate.limit / self.base_ns if self.base_ns else 0.0
        if ratio <= 0:
            return None
        ratio *= math.exp(scale * math.log(smallest))
        return ratio if gate.against is Against.RATIO else (ratio - 1) * self.base_ns


def options_for(gates: Sequence[Gate], options: CompareOptions) -> CompareOptions:
    """Add what the gates are about."""
    timed = [gate for gate in gates if gate.statistic]
    return replace(
        options,
        metrics=tuple(dict.fromkeys([*options.metrics, *(gate.metric for gate in timed)])),
        statistics=tuple(dict.fromkeys([*options.statistics, *(gate.statistic for gate in timed)])),
    )


def judge_gates(comparison: Comparison, gates: Sequence[Gate], *, allow_missing: bool = False) -> list[GateResult]:
    """Judge every group of the base by every gate of a comparison made with `options_for` them.

    First a result for each missing or dead group and each limit that fits none, then gate by gate.
    """
    if comparison.delivery.is_empty():
        return []
    names = varying_parameters(comparison.delivery, comparison.options.match)
    results = [] if allow_missing else [*_missing(comparison, names), *_without_result(comparison, gates)]
    families: dict[object, list[Gate]] = {}
    for number, gate in enumerate(gates):  # limits by result are one family, as one limit of all is
        families.setdefault((gate.metric, gate.statistic, gate.against) if gate.is_by_result else number, []).append(
            gate
        )
    for family in families.values():
        results += _judge(comparison, family, names)
    return results


def overall_outcome(outcomes: Iterable[GateOutcome]) -> GateOutcome:
    """Return the worst outcome."""
    worst_last = (GateOutcome.NOTHING_TO_COMPARE, GateOutcome.PASSED, GateOutcome.INCONCLUSIVE, GateOutcome.REGRESSED)
    return max(outcomes, key=worst_last.index, default=worst_last[0])


def _missing(comparison: Comparison, names: Sequence[str]) -> Iterator[GateResult]:
    for row in comparison.only_base.iter_rows(named=True):
        where = group_words(row, comparison.options.match)
        yield result_of(ALL_GROUPS, where, GateOutcome.REGRESSED, reason="missing on the new side")
    for number, (row, change) in enumerate(comparison.changes_of(RECEIVED_RATIO)):
        if row["is_dead"]:
            measured = group_words(row, names), GateOutcome.REGRESSED, change.new.value, *change.new.range
            yield result_of(ALL_GROUPS, *measured, reason="no reply was received on the new side", group=number)


def _without_result(comparison: Comparison, gates: Sequence[Gate]) -> Iterator[GateResult]:
    """Yield the limits that name no result; one of topics is for recordings of topics."""
    rows = [row for side in (comparison.delivery, comparison.only_base) for row in side.iter_rows(named=True)]
    only_new = comparison.only_new.to_dicts()
    files = {id(gate.sections): gate.sections for gate in gates if gate.sections is not None}
    fitted = {key: (sections.fitting(rows), sections.fitting(only_new)) for key, sections in files.items()}
    for gate in gates:
        in_base, in_new = fitted.get(id(gate.sections), (frozenset(), frozenset()))
        if gate.topics or not gate.results or gate.results in in_base:
            continue
        where = " ".join("=".join(pattern) for pattern in gate.results)
        is_new = gate.results in in_new
        reason = "the base has no such result" if is_new else "fits no result: correct it, or record what it names"
        outcome = GateOutcome.INCONCLUSIVE if is_new else GateOutcome.REGRESSED
        yield result_of(gate, where, outcome, reason=reason)


def _judge(comparison: Comparison, family: Sequence[Gate], names: Sequence[str]) -> Iterator[GateResult]:
    confidence, first = comparison.options.confidence, family[0]
    groups = list(_measured(comparison, family, names))
    topics = {name for name in comparison.delivery["data_type"] if is_topic(name)}
    for gate in family if topics or first.topic else ():  # else of other recordings
        if gate.topics and not fits_any(gate.topics, topics):
            reason = f"no tap heard it on both sides; topics: {', '.join(sorted(topics)[:_MOST_TOPICS]) or 'none'}"
            outcome = GateOutcome.INCONCLUSIVE if gate.topic else GateOutcome.REGRESSED
            yield result_of(gate, gate.topics, outcome, reason=reason)
    beyond = [
        index
        for index, group in enumerate(groups)
        if group.result.outcome is GateOutcome.REGRESSED and group.result.basis == Basis.BETWEEN_RUNS.value
    ]
    is_ratio = first.against is Against.RATIO or bool(first.statistic and first.against is Against.NEW)
    p_values = [groups[index].p_beyond(confidence, is_ratio=is_ratio) for index in beyond]
    # Groups that are not beyond the limit are of the family, too: their p values are larger than these.
    adjusted = holm_adjusted([*p_values, *[1.0] * (len(groups) - len(beyond))]).tolist()
    tests = dict(zip(beyond, zip(p_values, adjusted, strict=False), strict=True))
    for index, group in enumerate(groups):
        p, p_adjusted = tests.get(index, (None, None))
        is_by_chance = p_adjusted is not None and p_adjusted > (1 - confidence) / 2 + 1e-12
        # Between the same recordings nothing can have changed.
        is_equal = comparison.same_recordings and group.result.gate.against is not Against.NEW
        reason = "" if is_equal else _reason(comparison, group, len(groups) if is_by_chance else 0)
        outcome = GateOutcome.PASSED if is_equal else GateOutcome.INCONCLUSIVE if reason else group.result.outcome
        yield replace(
            group.result,
            p=p,
            p_adjusted=p_adjusted,
            verdict=outcome.value,
            reason=reason,
            found_from=group.found_from(len(groups), confidence),
            needs=group.advice.runs if reason and group.advice.text in reason else None,
        )


def _reason(comparison: Comparison, group: _Measured, by_chance_of: int) -> str:
    errors = [error.text for error in comparison.errors if error.is_about(group.key)]
    unfinished = comparison.unfinished.get(group.key, 0)
    if group.key in comparison.barred:
        return NOT_APPLIED
    if errors:
        return f"a side is not fit to be judged: {errors[0]}"
    if group.result.basis == Basis.WITHIN_RUN.value:
        return f"{Basis.WITHIN_RUN.value}: {group.advice.text}"
    if by_chance_of:
        return f"beyond the limit, but one of {by_chance_of} results is by chance ({FAMILY}); {group.advice.text}"
    if group.result.outcome is GateOutcome.PASSED and unfinished:
        return f"{counted(unfinished, 'run')} did not finish: record {'it' if unfinished == 1 else 'them'} again"
    return group.advice.text if group.result.outcome is GateOutcome.INCONCLUSIVE else ""


_VALUES = {
    Against.RATIO: "ratio{}",
    Against.DIFFERENCE: "difference{}_ns",
    Against.NEW: "new{}_ns",
    (RECEIVED_RATIO, Against.DIFFERENCE): "difference{}",
    (RECEIVED_RATIO, Against.NEW): "new_received_ratio{}",
}
"""What a limit applies to -> the columns of the value and, with `_low` and `_high`, of its ends."""


def _measured(comparison: Comparison, family: Sequence[Gate], names: Sequence[str]) -> Iterator[_Measured]:
    first = family[0]
    is_of_new, alpha = first.against is Against.NEW, 1 - comparison.options.confidence
    columns = _VALUES.get((first.metric, first.against)) or _VALUES[first.against]
    groups = {key: number for number, key in enumerate(comparison.delivery.select(comparison.options.match).rows())}
    rows = list(comparison.changes_of(first.metric, first.statistic))
    if first.topic:
        rows = [(row, change) for row, change in rows if is_topic(row["data_type"])]
    chosen = rows_of_gates(family, [row for row, _ in rows])
    for gate, (row, change) in ((gate, rows[n]) for gate, indices in zip(family, chosen, strict=True) for n in indices):
        key = tuple(row[name] for name in comparison.options.match)
        value, low, high = (row[columns.format(end)] for end in ("", "_low", "_high"))
        sides = [change.new] if is_of_new else [change.base, change.new]
        _check_passable(gate, change)
        units = change.new.units if gate.statistic else change.new.runs
        result = result_of(
            *(gate, group_words(row, names), gate.judge(value, low, high), value, low, high),
            basis=(change.new.basis if is_of_new else change.basis).value,
            group=groups[key],
            smallest_ratio=change.smallest_ratio,
            smallest_drop=None if is_of_new else row.get("smallest_drop"),
        )
        advice = _advice(gate, change) if gate.statistic else _advice_on_received(gate.limit, value, low, high, sides)
        if gate.statistic and result.outcome is GateOutcome.INCONCLUSIVE:
            advice = _or_longer(advice, gate, comparison.measured[key][-len(sides) :])
        yield _Measured(
            result=result,
            key=key,
            degrees=max(1, units - 1) if is_of_new else change.degrees,
            advice=advice,
            # A typical run at the limit is beyond it in every second run.
            p_of_lost=min(alpha / 2, 0.5**units) if is_of_new else (change.p_value or 0.0) / 2,
            base_ns=change.typical[0] or 0.0,
        )


def _check_passable(gate: Gate, change: Change) -> None:
    base_ns = change.base.value
    is_time_saved = gate.statistic and gate.against is Against.DIFFERENCE and gate.metric in METRICS
    if is_time_saved and gate.operator in (">", ">=") and base_ns is not None and base_ns + gate.limit < 0:
        base = format_duration(base_ns)
        raise OptionError(f"{gate.text}: no result can pass this, the base takes {base}; write a change of less, or %")


def _advice(gate: Gate, change: Change) -> _Advice:
    sides = [change.new] if gate.against is Against.NEW else [change.base, change.new]
    if few := _too_few_runs(sides):
        return _Advice(few, MIN_RUNS)
    statistic = STATISTIC_BY_NAME[gate.statistic]
    short = [side for side in sides if side.value is None]
    if short:
        return _Advice(f"{gate.statistic} takes {counted(statistic.needs, 'message')}, there are {short[0].samples}")
    if statistic.quantile is not None:
        more = [messages_to_close(side, statistic.quantile) for side in sides if not side.is_two_sided]
        if any(more):
            messages = format_number(max(m or 0 for m in more))
            return _Advice(f"too few messages beyond the percentile; record about {messages} more a side")
    base_ns = change.base.value or math.inf
    limit = 1 + gate.limit / base_ns if gate.against is Against.DIFFERENCE else gate.limit
    is_of_new = gate.against is Against.NEW
    runs = runs_to_settle_value(change.new, limit) if is_of_new else runs_to_settle_ratio(change, limit)
    return _Advice(_why_undecidable(sides, limit)) if runs is None else _runs_would_decide(runs, sides)


def _why_undecidable(sides: Sequence[Interval], limit: float) -> str:
    unlike = [side for side in sides if side.unit_spread is None]
    if any(side.upper == math.inf for side in unlike):
        return "too much was lost for more runs to decide"
    if unlike or limit <= 0:
        return UNDECIDABLE
    return "the measured value is too close to the limit for more runs to decide"


def _or_longer(advice: _Advice, gate: Gate, sides: Sequence[SetupRuns]) -> _Advice:
    """Add how much longer runs would decide, where runs differ by their messages only."""
    if not advice.runs:
        return advice
    runs = [side.delivered(gate.metric) for side in sides]
    if any(spread_of_runs(side, STATISTIC_BY_NAME[gate.statistic]).between != 0 for side in runs):
        return advice
    times = math.ceil(advice.runs / min(map(len, runs)))
    return advice._replace(text=advice.text.replace(" would", f", or {times} times the messages a run, would", 1))


def _too_few_runs(sides: Sequence[Interval]) -> str:
    if all(side.runs >= MIN_RUNS for side in sides):
        return ""
    return f"it takes {MIN_RUNS} runs a side, there are {' and '.join(str(side.runs) for side in sides)}"


def _runs_would_decide(runs: float, sides: Sequence[Interval]) -> _Advice:
    present = " and ".join(str(side.runs) for side in sides)
    if runs > MOST_RUNS:
        return _Advice(f"more than {MOST_RUNS:,} runs a side would decide, there are {present}")
    most = max(math.ceil(runs), *(side.runs + 1 for side in sides))
    return _Advice(f"about {most} runs a side would decide, there are {present}", most)


def _advice_on_received(
    limit: float, value: float | None, low: float | None, high: float | None, sides: Sequence[Interval]
) -> _Advice:
    if few := _too_few_runs(sides):
        return _Advice(few, MIN_RUNS)
    if value is None or low is None or high is None or math.isclose(value, limit, rel_tol=0.0, abs_tol=_ROUNDING):
        return _Advice(UNDECIDABLE)
    reach = high - value if value < limit else value - low
    return _runs_would_decide(max(side.runs for side in sides) * (reach / (value - limit)) ** 2, sides)
